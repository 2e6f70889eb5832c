// What the pointer is on, and what a click does there.
const CLICK = 5;  // farthest that a click may wander [pixels]
const ray = new THREE.Raycaster();
const pointed = document.getElementById("pointed");
const root = nodeAt("/mechanism");  // scaled: its own axes are in metres
let pressedAt = null;  // where a button went down

function aim(x, y) {
  const corner = new THREE.Vector2(2 * x / pane.clientWidth - 1, 1 - 2 * y / pane.clientHeight);
  ray.setFromCamera(corner, viewer.camera);
}

function hitAt(x, y) {  // what is seen there; signs are seen through bodies
  aim(x, y);
  const meshes = solids.filter(isShown).flatMap(solid => solid.meshes);
  const hits = ray.intersectObjects(meshes, false).filter(hit => !isCutOff(hit));
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

function ofWorld(seen) {  // a direction or point of the upright view, in the axes of the mechanism's world
  return film.world.map(row => row[0] * seen.x + row[1] * seen.y + row[2] * seen.z);
}

function nameAt(event) {
  if (event.buttons) { tellAt(event, ""); return; }
  const [x, y] = placeOf(event);
  if (ruler.on) { tellAt(event, hoverAt(x, y)); return; }
  const hit = hitAt(x, y);
  tellAt(event, hit ? hit.object.userData.solid.name : "");
}

function tellAt(event, words) {  // beside the pointer
  pointed.hidden = !words;
  if (!words) return;
  pointed.textContent = words;
  const [x, y] = [event.clientX, event.clientY];
  const room = innerWidth - pointed.offsetWidth - 4;
  pointed.style.transform = `translate(${Math.min(x + 14, room)}px, ${Math.max(y - 30, 2)}px)`;
}

pane.addEventListener("pointermove", unhurried(nameAt));
pane.addEventListener("pointerleave", () => { pointed.hidden = true; });
pane.addEventListener("pointerdown", event => { pressedAt = placeOf(event); pointed.hidden = true; });
pane.addEventListener("pointerup", event => {
  const [x, y] = placeOf(event);
  const still = pressedAt && Math.hypot(x - pressedAt[0], y - pressedAt[1]) < CLICK;
  if (!still || event.button !== 0) return;
  if (chase.asked) chaseAt(x, y);
  else if (ruler.on) pick(x, y);
  else if (inspector.on) inspectAt(x, y);
});
