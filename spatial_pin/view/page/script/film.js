// The film is meshcat's scene and animation; here it is built, stopped at a time, and told in words.
const THREE = MeshCat.THREE;
const pane = document.getElementById("meshcat-pane");
var viewer = new MeshCat.Viewer(pane, true, rendererWithoutWebGL());  // undefined: meshcat's own
for (const command of [...film.extras, ...film.commands]) viewer.handle_command_bytearray(command);
const home = viewer.camera.position.clone();
const animator = viewer.animator;
const [button, slider] = document.querySelectorAll("#player button:first-child, #player input");

function element(parent, kind, properties) {
  return parent.appendChild(Object.assign(document.createElement(kind), properties));
}

function drawing(parent, kind, attributes) {  // an element of an SVG
  const made = document.createElementNS("http://www.w3.org/2000/svg", kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return parent.appendChild(made);
}

const added = (list, parent, kind) => (list || []).map(
  () => element(document.getElementById(parent), kind, {}));
const outputs = added(film.readings, "readings", "output");
const warnings = added(film.alarms, "alarms", "output");
const labels = added(film.labels, "labels", "span");

// ---------------------------------------------------------------- time

function show(seconds) {  // while it plays, too
  animator.seek(seconds);
  animator.display_progress(seconds);
}

function seek(wish) {  // meshcat moves only what has been played
  animator.play();
  animator.pause();
  show(Math.min(Math.max(wish || 0, 0), animator.duration));
}

function between(x, from, to) {  // the value at x of a line through points (from, to); from rises or falls
  const way = from[from.length - 1] >= from[0] ? 1 : -1;
  const next = from.findIndex(s => way * (s - x) > 0);
  if (next < 0) return to[to.length - 1];
  if (next === 0) return to[0];
  const [s, t] = [from[next - 1], from[next]];
  if (to[next - 1] === null || to[next] === null) return null;
  return to[next - 1] + (x - s) / (t - s) * (to[next] - to[next - 1]);
}

function filmTime() { return animator.time; }

const valueAt = (seconds, values) => between(seconds, film.seconds, values);

// ---------------------------------------------------------------- words

function words(reading, value) {
  return reading.name + reading.says + value.replace("-", "−") + reading.unit;
}

function say() {
  film.readings.forEach((reading, k) => {
    const value = valueAt(animator.time, reading.values).toFixed(reading.digits);
    outputs[k].textContent = words(reading, value);
  });
  (film.alarms || []).forEach((alarm, k) => {
    const value = valueAt(animator.time, alarm.values);
    warnings[k].textContent = value > 0 ? words(alarm, value.toFixed(alarm.digits)) : "";
  });
}

function onScreen(point) {  // where the camera sees a point of the world [pixels]
  const seen = point.clone().project(viewer.camera);
  return [(seen.x + 1) / 2 * pane.clientWidth, (1 - seen.y) / 2 * pane.clientHeight];
}

function place() {  // the words of the picture, where the camera sees their points
  (film.labels || []).forEach((label, k) => {
    const [x, y] = onScreen(new THREE.Vector3(...label.at).applyMatrix4(viewer.scene.matrixWorld));
    labels[k].textContent = label.text;
    labels[k].style.transform = `translate(${x}px, ${y}px) translate(-50%, 20%)`;
  });
}
