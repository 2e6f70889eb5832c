// What the pointer is on: its name, and the distance between two points that are clicked.
const CLICK = 5;  // farthest that a click may wander [pixels]
const ray = new THREE.Raycaster();
const pointed = document.getElementById("pointed");
const ruler = {svg: document.getElementById("ruler"), on: false, picks: []};
let pressedAt = null;  // where a button went down

function aim(x, y) {
  const corner = new THREE.Vector2(2 * x / pane.clientWidth - 1, 1 - 2 * y / pane.clientHeight);
  ray.setFromCamera(corner, viewer.camera);
}

function hitAt(x, y) {  // what is seen there; signs are seen through bodies
  aim(x, y);
  const meshes = solids.filter(isShown).flatMap(solid => solid.meshes);
  const hits = ray.intersectObjects(meshes, false);
  return hits.find(hit => !hit.object.material.depthTest) || hits[0];
}

function placeOf(event) {
  const box = pane.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

function unhurried(act) {  // a scene of a million triangles is not looked through at every step of the pointer
  let free = 0;
  return event => {
    const start = performance.now();
    if (start < free) return;
    act(event);
    free = 2 * performance.now() - start;
  };
}

function nameAt(event) {
  const hit = event.buttons ? undefined : hitAt(...placeOf(event));
  pointed.hidden = !hit;
  if (!hit) return;
  pointed.textContent = hit.object.userData.solid.name;
  const [x, y] = [event.clientX, event.clientY];
  const room = innerWidth - pointed.offsetWidth - 4;
  pointed.style.transform = `translate(${Math.min(x + 14, room)}px, ${Math.max(y - 30, 2)}px)`;
}

// ---------------------------------------------------------------- distances

function pickOf(hit) {  // a point of a body, which moves with it; of a pair's sign its middle
  const {solid} = hit.object.userData;
  const frame = solid.at || solid.along ? solid.node.parent : hit.object;
  const point = solid.at ? new THREE.Vector3(...solid.at) : frame.worldToLocal(hit.point.clone());
  const axis = solid.along ? new THREE.Vector3(...solid.along) : null;
  return {frame, point, axis, name: solid.name};
}

function pick(x, y) {
  const hit = hitAt(x, y);
  if (!hit) return;
  if (ruler.picks.length === 2) ruler.picks = [];
  ruler.picks.push(pickOf(hit));
}

const inWorld = ({frame, point}) => frame.localToWorld(point.clone());

function lengthWords(metres, size = Math.abs(metres)) {
  const [unit, name] = [[1, "m"], [1e-3, "mm"], [1e-6, "µm"], [1e-9, "nm"]].find(([u]) => size >= u) || [1, "m"];
  return `${Number((metres / unit).toPrecision(5))} ${name}`.replace("-", "−");
}

function inMetres(from, to) {  // along the axes of the mechanism's world
  const d = to.clone().sub(from).multiplyScalar(film.radius);
  const seen = [d.x, -d.z, d.y];  // the scene has z up, three.js y
  return film.world.map(row => row[0] * seen[0] + row[1] * seen[1] + row[2] * seen[2]);
}

function measure() {
  const drawn = ruler.picks.length;
  if (!drawn && !ruler.svg.firstChild) return;
  ruler.svg.replaceChildren();
  if (!drawn) return;
  const points = ruler.picks.map(inWorld);
  const seen = points.map(onScreen);
  if (drawn === 2) drawDistance(points, seen);
  for (const [cx, cy] of seen) drawing(ruler.svg, "circle", {cx, cy, r: 4.5});
}

function drawDistance(points, [[x1, y1], [x2, y2]]) {
  drawing(ruler.svg, "line", {x1, y1, x2, y2});
  const parts = inMetres(...points);
  const metres = Math.hypot(...parts);
  const round = parts.map(x => Math.abs(x) < 1e-9 * film.radius ? 0 : x);
  const [x, y] = [(x1 + x2) / 2, (y1 + y2) / 2];
  drawing(ruler.svg, "text", {x, y: y - 24}).textContent = lengthWords(metres);
  drawing(ruler.svg, "text", {x, y: y - 8}).textContent =
    ["x", "y", "z"].map((axis, k) => `${axis} ${lengthWords(round[k], metres)}`).join(" · ");
  const angle = angleBetween(...ruler.picks);
  if (angle !== null) drawing(ruler.svg, "text", {x, y: y - 40}).textContent = `axes ${briefly(Number(angle.toFixed(3)))}°`;
}

function angleBetween(one, other) {  // of two axes [degrees], 0 to 90; null where one has none
  if (!one.axis || !other.axis) return null;
  const [a, b] = [one, other].map(({frame, axis}) => axis.clone().transformDirection(frame.matrixWorld));
  return Math.atan2(a.clone().cross(b).length(), Math.abs(a.dot(b))) * 180 / Math.PI;
}

function setRuler(on) {
  ruler.on = on;
  ruler.picks = [];
  document.body.classList.toggle("measuring", on);
}

pane.addEventListener("pointermove", unhurried(nameAt));
pane.addEventListener("pointerleave", () => { pointed.hidden = true; });
pane.addEventListener("pointerdown", event => { pressedAt = placeOf(event); pointed.hidden = true; });
pane.addEventListener("pointerup", event => {
  const [x, y] = placeOf(event);
  const still = pressedAt && Math.hypot(x - pressedAt[0], y - pressedAt[1]) < CLICK;
  if (!still || event.button !== 0) return;
  if (chase.asked) chaseAt(x, y); else if (ruler.on) pick(x, y);
});
