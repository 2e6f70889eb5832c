// What is shown: groups of solids, and the links one by one.
const GROUPS = {
  links: "Links", springs: "Springs", gaps: "Open closures", contacts: "Curves", pairs: "Pairs", axes: "Axes", centres: "Centres of mass",
  clearance: "Clearance", workspace: "Workspace", design: "What was asked", traces: "Paths", arrows: "Arrows",
  ghosts: "Other configurations", grid: "Ground grid", edges: "Edges", shadow: "Shadow",
};
const MANY = 15;  // links that are found faster by typing than by reading
const nodeAt = path => viewer.scene_tree.find(path.split("/").slice(1)).object;
const hidden = {group: new Set(film.hidden), link: new Set()};  // names of what is not shown
const solids = [...film.parts, {path: film.grid, group: "grid", name: "ground grid"}].map(solidOf);

function solidOf(part) {
  const made = {...part, node: nodeAt(part.path), meshes: []};
  made.node.traverse(object => {
    if (!object.isMesh) return;
    object.userData.solid = made;
    made.meshes.push(object);
  });
  return made;
}

function isShown(solid) {
  return !hidden.group.has(solid.group) && !(solid.group === "links" && hidden.link.has(solid.name));
}

function showParts() {
  for (const solid of solids) solid.node.visible = isShown(solid);
  viewer.set_dirty();
}

function setShown(kind, name, shown) {
  if (shown) hidden[kind].delete(name); else hidden[kind].add(name);
  showParts();
}

function highlight(name, on) {
  for (const solid of solids.filter(s => s.group === "links" && s.name === name))
    for (const mesh of solid.meshes) mesh.material.emissive.setHex(on ? 0x444444 : 0);
  viewer.set_dirty();
}

function sizeOf(mesh) {
  mesh.geometry.computeBoundingBox();
  const box = mesh.geometry.boundingBox.clone().applyMatrix4(mesh.matrix);
  return box.max.distanceTo(box.min);
}

function largestOf(link) {  // of its meshes
  const meshes = solids.filter(s => s.group === "links" && s.name === link).flatMap(s => s.meshes);
  return meshes.reduce((one, other) => sizeOf(other) > sizeOf(one) ? other : one);
}

function partRow(kind, name, text, colour) {
  const row = element(document.getElementById("parts"), "label", {});
  const box = element(row, "input", {type: "checkbox", checked: !hidden[kind].has(name)});
  box.dataset[kind] = name;
  box.onchange = () => setShown(kind, name, box.checked);
  if (colour) element(row, "i", {}).style.background = colour;
  element(row, "span", {textContent: text});
  return row;
}

function showOnly(link) {  // all links if it is the only one shown
  const others = new Set(solids.filter(s => s.group === "links" && s.name !== link).map(s => s.name));
  const alone = [...others].every(name => hidden.link.has(name));
  hidden.link = alone ? new Set() : others;
  for (const box of document.querySelectorAll("#parts [data-link]")) box.checked = !hidden.link.has(box.dataset.link);
  showParts();
}

function listParts() {
  const panel = document.getElementById("parts");
  element(panel, "h2", {textContent: "Shown"});
  const groups = Object.keys(GROUPS).filter(group => solids.some(s => s.group === group));
  for (const group of groups) partRow("group", group, GROUPS[group]);
  element(panel, "h2", {textContent: "Links"});
  const names = [...new Set(solids.filter(s => s.group === "links").map(s => s.name))], rows = [];
  if (names.length > MANY) element(panel, "input", {type: "search", placeholder: "find a link", oninput: ({target}) => {
    for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(target.value.toLowerCase());
  }});
  for (const name of names) {
    const row = partRow("link", name, name, `#${largestOf(name).material.color.getHexString()}`);
    rows.push(row);
    row.onmouseenter = () => highlight(name, true);
    row.onmouseleave = () => highlight(name, false);
    row.title = "double click: this one only, or all";
    row.ondblclick = () => showOnly(name);
  }
}
