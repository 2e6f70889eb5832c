// Curves that are added in the page: coordinates and their rates, reactions, positions of frames.
const wanted = document.querySelector("#curves input"), known = document.getElementById("signals");
const signals = new Map([
  ...film.signals.told.map(({name, unit}, k) => [name, () => panelData(name, unit, [["", film.values[k]]])]),
  ...film.frames.map(frame => [`${frame.name}.position`, () => positionData(frame)])]);

function panelData(name, unit, lines) {
  return {name, label: `${name} [${unit}]`, unit, lines: lines.map(([axis, values]) => ({name: axis, values: Array.from(values)}))};
}

function trackOf(node, kind) {  // what meshcat moves it by; undefined of what stands still
  const action = animator.actions.find(one => one.getRoot() === node);
  return action && action.getClip().tracks.find(({name}) => name === `.${kind}`).values;
}

function positionData({name, joint, at}) {  // in every sample, in the axes of the world
  const node = jointNode(joint), places = trackOf(node, "position"), turns = trackOf(node, "quaternion");
  const rows = film.seconds.map((_, row) => {
    const place = places ? new THREE.Vector3().fromArray(places, 3 * row) : node.position;
    const turn = turns ? new THREE.Quaternion().fromArray(turns, 4 * row) : node.quaternion;
    return ofWorld(new THREE.Vector3(...at).applyQuaternion(turn).add(place));
  });
  return panelData(`${name}.position`, "m", ["x", "y", "z"].map((axis, k) => [axis, rows.map(row => row[k])]));
}

function listSignals() {  // those that are not there yet
  const there = panels.map(({data}) => data.name);
  known.replaceChildren();
  for (const name of signals.keys()) if (!there.includes(name)) element(known, "option", {value: name});
}

function addWanted() {
  const name = wanted.value.trim(), isThere = panels.some(({data}) => data.name === name);
  const unknown = name !== "" && !signals.has(name);
  wanted.setCustomValidity(unknown ? "There is no such quantity in this page." : "");
  wanted.reportValidity();
  if (unknown) return;
  if (name && !isThere) add(signals.get(name)());
  wanted.value = "";
}

wanted.onchange = addWanted;
wanted.parentNode.hidden = !film.curves || animator.duration === 0;
for (const data of film.curves ? film.curves.panels : []) panels.push(panelOf(data));
listSignals();
