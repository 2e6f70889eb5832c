// The camera. Its own axes have y up, those of the scene z: (x, y, z) of the scene is its (x, z, -y).
const VIEWS = {front: [0, -1, 0], top: [0, 0, 1], side: [1, 0, 0], iso: [1, -1, 1]};
const ROOM = 1.15;  // round what is seen, for what is written over it
const PARALLEL = 2;  // field of view [degrees] at which lines that are parallel are drawn so, to a pixel or two
const DEEP = 30;  // before and behind what is looked at there is something to be seen, by the size of the scene
const ORDINARY = {fov: viewer.camera.fov, near: viewer.camera.near};
let moved = false;  // by the user
let seenFrom = null;  // unit vector to the camera; null: as at first
let inRoom = 0;  // of `rooms`, the one that the picture stands in
viewer.controls.addEventListener("start", () => { moved = true; });
viewer.controls.addEventListener("change", keepDepths);

const ofCamera = ([x, y, z]) => new THREE.Vector3(x, z, -y);
let extent = () => film.extent.map(ofCamera);  // the points that the picture holds

function lookFrom(direction) {
  seenFrom = direction && direction.clone().normalize();
  moved = false;
  fit();
}

function view(name) {
  if (name === "fit") {
    const asAtFirst = seenFrom === null && !moved && film.seconds.length && !isNarrow();
    lookFrom(asAtFirst && !film.refits ? null : viewer.camera.position.clone().sub(viewer.controls.target));
  } else lookFrom(name === "first" ? null : ofCamera(VIEWS[name]));
  remember();
}

function fit() {  // after the window has changed; never against the user
  makeWay();
  if (moved) return;
  if (seenFrom === null && !isCrowded()) asAtFirst();
  else frameAll(extent(), seenFrom || home.clone().normalize());
  makeWay();
  viewer.controls.update();
  keepDepths();
  viewer.set_dirty();
}

function setParallel(on) {  // seen from very far, through a long lens
  const {camera, controls} = viewer;
  const fov = on ? PARALLEL : ORDINARY.fov;
  const nearer = Math.tan(camera.fov * Math.PI / 360) / Math.tan(fov * Math.PI / 360);
  camera.position.sub(controls.target).multiplyScalar(nearer).add(controls.target);
  camera.fov = fov;
  fit();
  viewer.set_dirty();
}

function keepDepths() {  // near and far too far apart would leave none between
  const {camera, controls} = viewer;
  const away = camera.position.distanceTo(controls.target);
  camera.near = Math.max(ORDINARY.near, away - DEEP);
  camera.far = away + DEEP;
}

function asAtFirst() {  // a picture that is narrower than it was made for is seen from further off
  const away = Math.max(1, film.aspect * pane.clientHeight / pane.clientWidth);
  const lens = Math.tan(ORDINARY.fov * Math.PI / 360) / Math.tan(viewer.camera.fov * Math.PI / 360);
  viewer.controls.target.set(0, 0, 0);
  viewer.camera.position.copy(home).multiplyScalar(away * lens);
}

function frameAll(points, towards) {  // in the middle of that room where they are seen largest
  const found = rooms().map(room => framed(points, towards, room));
  inRoom = found.reduce((best, {away}, k) => away < found[best].away ? k : best, 0);
  const {target, away} = found[inRoom];
  viewer.controls.target.copy(target);
  viewer.camera.position.copy(target).addScaledVector(towards, away);
}

function framed(points, towards, room) {  // what is looked at, and from how far
  const up = Math.abs(towards.y) > 0.999 ? new THREE.Vector3(0, 0, -1) : new THREE.Vector3(0, 1, 0);
  const right = up.clone().cross(towards).normalize();
  up.copy(towards).cross(right);
  const half = Math.tan(viewer.camera.fov * Math.PI / 360) / ROOM / pane.clientHeight;
  const halves = [half * room.width, half * room.height];
  const target = new THREE.Vector3();
  let away = 1;
  for (let k = 0; k < 5; k++) {
    const seen = points.map(p => p.clone().sub(target)).map(p => [p.dot(right), p.dot(up), p.dot(towards)]);
    away = Math.max(...seen.map(([x, y, z]) => z + Math.max(Math.abs(x) / halves[0], Math.abs(y) / halves[1])));
    target.addScaledVector(right, away * middle(seen.map(([x, , z]) => x / (away - z))));
    target.addScaledVector(up, away * middle(seen.map(([, y, z]) => y / (away - z))));
  }
  return {target, away};
}

const middle = values => (Math.min(...values) + Math.max(...values)) / 2;

// ---------------------------------------------------------------- the room the picture has

const below = document.getElementById("below");
const fill = viewer.set_3d_pane_size.bind(viewer);  // meshcat's own takes the whole height
viewer.set_3d_pane_size = (width, height) => fill(width, height === undefined ? pane.clientHeight : height);

function share() {  // the window between the picture and what stands below it
  const taken = below.offsetHeight;
  pane.style.height = `${innerHeight - taken}px`;
  document.body.style.setProperty("--below", `${taken}px`);
  viewer.set_3d_pane_size();
  const [tools, triad, says, legend] = ["tools", "triad", "says", "legend"]
    .map(id => document.getElementById(id).getBoundingClientRect());
  document.body.classList.toggle("short", triad.top < tools.bottom);
  document.body.classList.toggle("low", legend.top < says.bottom);
  fit();
}

function covered() {  // by the buttons, at the right [pixels]
  const {offsetWidth} = document.getElementById("tools");
  return offsetWidth && offsetWidth + 12;
}

const isNarrow = () => pane.clientWidth < film.aspect * pane.clientHeight;

const isCrowded = () => isNarrow() && covered() > 0;

function rooms() {  // of the picture, that nothing is written over: beside the buttons and below them
  const [width, height] = [pane.clientWidth, pane.clientHeight];
  if (!isCrowded()) return [{x: 0, y: 0, width, height}];
  const edge = (id, side) => document.getElementById(id).getBoundingClientRect()[side];
  const end = Math.min(height, ...["player", "legend"].map(id => edge(id, "top")).filter(top => top > height / 2));
  const start = Math.min(edge("says", "bottom"), end / 2);
  const above = Math.min(end, edge("triad", "top"));
  const below = Math.min(Math.max(start, edge("tools", "bottom")), above - 1);
  return [{x: 0, y: start, width: width - covered(), height: end - start}, {x: 0, y: below, width, height: above - below}];
}

function makeWay() {  // the picture goes aside from under the buttons, as far as its margin lets it
  const [width, height] = [pane.clientWidth, pane.clientHeight];
  const half = Math.min(width, film.aspect * height) / 2 / ROOM;
  const wanted = covered() && half + covered() - width / 2;
  const margin = Math.max(0, Math.min(wanted, width / 2 * (1 - 1 / ROOM)));
  const room = isCrowded() && rooms()[inRoom];
  const [x, y] = room ? [(width - room.width) / 2 - room.x, (height - room.height) / 2 - room.y] : [margin, 0];
  viewer.camera.setViewOffset(width, height, x, y, width, height);
}

for (const one of document.querySelectorAll("[data-view]")) one.onclick = () => view(one.dataset.view);
new ResizeObserver(share).observe(below);
addEventListener("resize", share);
share();
