// A camera that goes with a link.
const chase = {solid: null, last: null, asked: false};  // asked: the next click names the link

function middleOf({meshes: [mesh]}) {  // of a solid, in the world
  if (!mesh.geometry.boundingBox) mesh.geometry.computeBoundingBox();
  return mesh.localToWorld(mesh.geometry.boundingBox.getCenter(new THREE.Vector3()));
}

function goWith(link) {  // it comes to the middle of the picture and stays there
  chase.solid = largestOf(link).userData.solid;
  chase.last = viewer.controls.target.clone();
  moved = true;
}

function setChase(on) {
  chase.asked = on;
  if (!on) chase.solid = null;
  document.body.classList.toggle("asking", on);
}

function chaseAt(x, y) {  // a click
  const hit = hitAt(x, y);
  const link = hit && linkOf(hit.object.userData.solid);
  if (!link) return;
  chase.asked = false;
  document.body.classList.remove("asking");
  goWith(link);
}

function linkOf(solid) {
  return solid.group === "links" ? solid.name : null;
}

function toggleChase() {  // by its key: the link that the pointer is on, or the one that is clicked next
  const link = pointed.hidden ? null : solids.map(linkOf).find(name => name === pointed.textContent);
  toggleTool("chase");
  if (link && chase.asked) { setChase(false); goWith(link); }
}

function keepUp() {  // in every picture
  if (!chase.solid) return;
  if (!moved) { toggleTool("chase", false); return; }  // another view was asked for
  const here = middleOf(chase.solid);
  const way = here.clone().sub(chase.last);
  chase.last = here;
  if (way.lengthSq() < 1e-18) return;
  viewer.camera.position.add(way);
  viewer.controls.target.add(way);
  viewer.controls.update();
  keepDepths();
  viewer.set_dirty();
}
