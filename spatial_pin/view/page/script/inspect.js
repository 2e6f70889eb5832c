// What there is to be said of a link or a pair, at the moment that is shown.
const inspector = {on: false, told: null, cells: [], panel: document.getElementById("inspector")};
const whose = inspector.panel.querySelector("select");
const table = inspector.panel.querySelector("dl");
const inspected = new Map([
  ...film.frames.filter(({name, mass}) => mass || solids.some(s => s.group === "links" && s.name === name)).map(frame => [`link ${frame.name}`, frame]),
  ...film.pairs.map(pair => [`pair ${pair.name}`, pair])]);

const placed = (joint, at) => inMetres(root.localToWorld(new THREE.Vector3()), jointNode(joint).localToWorld(new THREE.Vector3(...at)));
const vectorWords = values => {  // one unit for all
  const size = Math.max(...values.map(Math.abs));
  const words = values.map(x => lengthWords(Math.abs(x) < 1e-9 * film.radius ? 0 : x, size).split(" "));
  return `${words.map(([x]) => x).join(", ")} ${words[0][1]}`;
};
const signalsOf = (pair, what) => film.signals.told.map((one, k) => ({...one, values: film.values[k]})).filter(s => s.pair === pair && s.what === what);
const linkOn = joint => film.frames.find(frame => frame.joint === joint && inspected.has(`link ${frame.name}`)) || film.frames.find(frame => frame.joint === joint);

function turnWords({joint, turn}) {  // roll, pitch, yaw about the fixed axes of the world, as a URDF has them
  const inRoot = new THREE.Matrix4().copy(root.matrixWorld).invert().multiply(jointNode(joint).matrixWorld);
  const {elements} = new THREE.Matrix4().extractRotation(inRoot).multiply(new THREE.Matrix4().makeRotationFromQuaternion(new THREE.Quaternion(...turn)));
  const [x, y, z] = [0, 4, 8].map(k => ofWorld({x: elements[k], y: elements[k + 1], z: elements[k + 2]}));
  const pitch = Math.asin(Math.max(-1, Math.min(1, -x[2])));
  const upright = Math.abs(x[2]) < 1 - 1e-7;  // else roll and yaw turn about the same axis
  const angles = upright ? [Math.atan2(y[2], z[2]), pitch, Math.atan2(x[1], x[0])] : [0, pitch, Math.atan2(-y[0], y[1])];
  return angles.map(a => `${(a * 180 / Math.PI).toFixed(2).replace(/^-(0\.00)$/, "$1")}°`.replace("-", "−")).join(", ");
}

function tellLink(frame) {
  const own = film.pairs.filter(pair => pair.joints.includes(frame.joint));
  const parent = film.pairs[frame.joint - 1];  // those of the tree come first, one for each joint
  if (frame.mass) {
    row("mass", () => `${briefly(frame.mass)} kg`);
    row("centre of mass", () => vectorWords(placed(frame.joint, comOf(frame))));
  }
  row("origin", () => vectorWords(placed(frame.joint, frame.at)));
  row("roll, pitch, yaw", () => turnWords(frame));
  if (parent) lead("parent pair", [`pair ${parent.name}`]);
  lead("other pairs", own.filter(pair => pair !== parent).map(pair => `pair ${pair.name}`));
}

function comOf({at, turn, com}) {  // in the frame of its joint
  return new THREE.Vector3(...com).applyQuaternion(new THREE.Quaternion(...turn)).add(new THREE.Vector3(...at)).toArray();
}

function tellPair(pair) {
  row("kind", () => pair.kind.replaceAll("_", " "));
  lead("between", pair.joints.map(linkOn).filter(Boolean).map(frame => `link ${frame.name}`));
  row("middle", () => vectorWords(placed(pair.joints[1], pair.at[1])));
  for (const what of ["value", "rate", "force", "moment"])
    for (const {name, unit, values} of signalsOf(pair.name, what))
      row(what === "value" ? name : what === "rate" ? name : `reaction, ${what}${name.endsWith("many") ? " (one of many)" : ""}`,
        () => `${briefly(valueNow(values))}${unit === "°" ? "" : " "}${unit}`);
}

const valueNow = values => values.length > 1 ? valueAt(animator.time, values) : values[0];

function row(label, tell) {
  element(table, "dt", {textContent: label});
  inspector.cells.push({cell: element(table, "dd", {}), tell});
}

function lead(label, keys) {  // buttons that lead to others
  const known = keys.filter(key => inspected.has(key));
  if (!known.length) return;
  element(table, "dt", {textContent: label});
  const cell = element(table, "dd", {});
  for (const key of known) element(cell, "button", {type: "button", textContent: inspected.get(key).name, onclick: () => inspect(key)});
}

function inspect(key) {
  if (inspector.told) highlight(inspector.told.slice(5), false);
  inspector.told = key;
  inspector.cells = [];
  table.replaceChildren();
  whose.value = key;
  if (key.startsWith("link")) { highlight(key.slice(5), true); tellLink(inspected.get(key)); }
  else tellPair(inspected.get(key));
  tellInspected();
}

function inspectAt(x, y) {  // a click
  const hit = hitAt(x, y);
  if (!hit) return;
  const {group, name} = hit.object.userData.solid;
  const key = group === "links" ? `link ${name}` : `pair ${name.replace(/^axis of /, "").replace(/: [a-z_]*$/, "")}`;
  if (inspected.has(key)) inspect(key);
}

function setInspector(on) {
  inspector.on = on;
  document.body.classList.toggle("inspecting", on);
  inspector.panel.hidden = !on;
  if (on) inspect(inspector.told || whose.value);
  else if (inspector.told) highlight(inspector.told.slice(5), false);
}

function tellInspected() {  // in every picture
  if (!inspector.on) return;
  for (const one of inspector.cells) {
    const words = one.tell();
    if (words !== one.words) one.cell.textContent = one.words = words;
  }
}

for (const kind of ["link", "pair"]) {
  const group = element(whose, "optgroup", {label: `${kind}s`});
  for (const [key, {name}] of inspected) if (key.startsWith(kind)) element(group, "option", {value: key, textContent: name});
}
whose.onchange = () => inspect(whose.value);
