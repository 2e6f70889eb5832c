// Distances between two places that are clicked. The pointer snaps to what has a name: middles of pairs,
// origins of frames, corners, axes; a place anywhere else is one of a surface.
const SNAP = 11;  // farthest that the pointer is from what it snaps to [pixels]
const AXIS_REACH = 0.35;  // how far from its pair an axis can be met, by the size of the scene
const ruler = {svg: document.getElementById("ruler"), on: false, picks: [], near: null};
const jointNode = k => nodeAt(film.joints[k]);
const framed3 = values => new THREE.Vector3(...values);
const pairCentres = film.pairs.flatMap(({name, kind, joints, at, along}) => [1, 0].map(side => ({
  of: name, frame: jointNode(joints[side]), point: framed3(at[side]), axis: side && along ? framed3(along) : null,
  name: `middle of ${name} (${kind.replace("_", " ")})`})));
const frameOrigins = film.frames.map(({name, joint, at}) => ({
  frame: jointNode(joint), point: framed3(at), axis: null, name: `origin of ${name}`}));
const pairAxes = pairCentres.filter(({axis}) => axis).map(
  ({of, frame, point, axis}) => ({frame, point, axis, line: true, name: `axis of ${of}`}));

const inWorld = ({frame, point}) => frame.localToWorld(point.clone());
const axisInWorld = ({frame, axis}) => axis.clone().transformDirection(frame.matrixWorld);

function offPointer(pick, x, y) {  // [pixels]
  const [px, py] = onScreen(inWorld(pick));
  return Math.hypot(px - x, py - y);
}

function nearestPick(picks, x, y) {
  let [best, least] = [null, SNAP];
  for (const one of picks) {
    const off = offPointer(one, x, y);
    if (off < least - 0.01) [best, least] = [one, off];
  }
  return best;
}

function corner(hit) {  // of the triangle that is hit, the one that is nearest on the screen
  const frame = hit.object, places = frame.geometry.attributes.position, {group, name} = frame.userData.solid;
  return ["a", "b", "c"].map(k => ({
    frame, axis: null, name: `${group === "links" ? "corner" : "point"} of ${name}`,
    point: new THREE.Vector3().fromBufferAttribute(places, hit.face[k])}));
}

function onAxis(pick) {  // the point of an axis that is nearest to the ray from the eye
  const from = inWorld(pick), along = axisInWorld(pick);
  const at = closest(from, along, ray.ray.origin, ray.ray.direction);
  if (at === null || Math.abs(at) > AXIS_REACH) return null;
  return {...pick, point: pick.frame.worldToLocal(from.addScaledVector(along, at))};
}

function closest(from, along, other, direction) {  // how far along the first line it is nearest to the second; null: parallel
  const d = other.clone().sub(from), b = along.dot(direction), det = 1 - b * b;
  return det < 1e-9 ? null : (d.dot(along) - b * d.dot(direction)) / det;
}

function pickOf(hit) {  // of a sign the middle of its pair, of an axis a point of it, else one of the surface
  const {solid} = hit.object.userData, axis = solid.along ? framed3(solid.along) : null;
  const frame = axis || solid.at ? solid.node.parent : hit.object;
  const point = solid.at ? framed3(solid.at) : frame.worldToLocal(hit.point.clone());
  const what = solid.at ? "middle of " : axis ? "" : "surface of ";
  return {frame, point, axis, line: !solid.at && axis !== null, name: what + solid.name};
}

function snapAt(x, y) {  // what a click there would take; null where there is nothing
  const hit = hitAt(x, y);
  const solid = hit && hit.object.userData.solid;
  if (hit && (solid.at || solid.along)) return pickOf(hit);  // a sign or an axis that is shown
  const shown = picks => picks.filter(pick => !isBeyondCut(inWorld(pick)));
  const named = [pairCentres, frameOrigins, hit ? corner(hit) : [], pairAxes.map(onAxis).filter(Boolean)];
  for (const picks of named) {
    const found = nearestPick(shown(picks), x, y);
    if (found) return found;
  }
  return hit ? pickOf(hit) : null;
}

function hoverAt(x, y) {  // words of what a click there would take
  ruler.near = snapAt(x, y);
  return ruler.near ? ruler.near.name : "";
}

function pick(x, y) {
  const found = snapAt(x, y);
  if (!found) return;
  if (ruler.picks.length === 2) ruler.picks = [];
  ruler.picks.push(found);
}

// ---------------------------------------------------------------- what is told

function lengthWords(metres, size = Math.abs(metres)) {
  const [unit, name] = [[1, "m"], [1e-3, "mm"], [1e-6, "µm"], [1e-9, "nm"]].find(([u]) => size >= u) || [1, "m"];
  return `${Number((metres / unit).toPrecision(5))} ${name}`.replace("-", "−");
}

function inMetres(from, to) {  // along the axes of the mechanism's world
  const d = to.clone().sub(from).multiplyScalar(film.radius);
  return ofWorld({x: d.x, y: -d.z, z: d.y});  // the scene has z up, three.js y
}

function spanned(picks) {  // of what is measured: an axis is as near as it comes
  const points = picks.map(inWorld);
  if (picks.length < 2) return points;
  const lines = picks.map(pick => pick.line ? axisInWorld(pick) : null);
  if (lines[0] && lines[1]) {
    const at = closest(points[0], lines[0], points[1], lines[1]);
    if (at !== null) points[0].addScaledVector(lines[0], at);
  }
  [[0, 1], [1, 0]].forEach(([own, other]) => {
    if (!lines[own] || own === 0 && lines[1]) return;
    points[own].addScaledVector(lines[own], points[other].clone().sub(points[own]).dot(lines[own]));
  });
  return points;
}

function measure() {
  const {svg, picks, near, on} = ruler;
  if (!picks.length && !near && !svg.firstChild) return;
  svg.replaceChildren();
  const points = spanned(picks), seen = points.map(onScreen);
  if (picks.length === 2) drawDistance(points, seen);
  for (const [cx, cy] of seen) drawing(svg, "circle", {cx, cy, r: 4.5});
  if (!on || !near || pointed.hidden) return;
  const [x, y] = onScreen(inWorld(near));
  drawing(svg, "rect", {x: x - 5, y: y - 5, width: 10, height: 10});
}

function drawDistance(points, [[x1, y1], [x2, y2]]) {
  drawing(ruler.svg, "line", {x1, y1, x2, y2});
  const parts = inMetres(...points), metres = Math.hypot(...parts);
  const round = parts.map(x => Math.abs(x) < 1e-9 * film.radius ? 0 : x);
  const angle = angleBetween(...ruler.picks);
  const lines = ruler.picks.map(({name}) => name);
  if (angle !== null) lines.push(`axes ${briefly(Number(angle.toFixed(3)))}°`);
  lines.push(lengthWords(metres), ["x", "y", "z"].map((axis, k) => `${axis} ${lengthWords(round[k], metres)}`).join(" · "));
  const [x, y] = [(x1 + x2) / 2, Math.max((y1 + y2) / 2 - 16 * lines.length + 8, 16)];
  const texts = lines.map((text, k) => Object.assign(drawing(ruler.svg, "text", {x, y: y + 16 * k}), {textContent: text}));
  const half = Math.max(...texts.map(text => text.getComputedTextLength())) / 2 + 6;
  const inside = Math.max(half, Math.min(x, pane.clientWidth - covered() - half));
  for (const text of texts) text.setAttribute("x", inside);
}

function angleBetween(one, other) {  // of two axes [degrees], 0 to 90; null where one has none
  if (!one.axis || !other.axis) return null;
  const [a, b] = [one, other].map(axisInWorld);
  return Math.atan2(a.clone().cross(b).length(), Math.abs(a.dot(b))) * 180 / Math.PI;
}

function setRuler(on) {
  ruler.on = on;
  ruler.picks = [];
  ruler.near = null;
  document.body.classList.toggle("measuring", on);
}
