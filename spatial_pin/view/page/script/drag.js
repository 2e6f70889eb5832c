// A link that is dragged: its point follows the pointer, as far as the drivers and their limits let it.
const joints = new Set(live.joints);  // meshcat paths of what moves
let grip = null;  // what is held: the joint's path and the point in its frame

function jointOf(solid) {
  const parent = solid.path.slice(0, solid.path.lastIndexOf("/"));
  return joints.has(parent) ? parent : null;
}

const canGrip = event => !(event.shiftKey || event.ctrlKey || ruler.on || inspector.on || chase.asked) && jointAt(event) !== null;

function jointAt(event) {
  const hit = hitAt(...placeOf(event));
  return hit ? jointOf(hit.object.userData.solid) : null;
}

function gripAt(event) {
  if (event.button !== 0 || !canGrip(event)) return null;
  const hit = hitAt(...placeOf(event));
  const joint = jointOf(hit.object.userData.solid);
  return {joint, point: nodeAt(joint).worldToLocal(hit.point.clone()).toArray()};
}

function rayAt(event) {  // from the eye through the pointer [m]
  aim(...placeOf(event));
  const [eye, ahead] = [ray.ray.origin.clone(), ray.ray.origin.clone().add(ray.ray.direction)].map(p => root.worldToLocal(p));
  return {origin: ofWorld(eye), direction: ofWorld(ahead.sub(eye).normalize())};
}

const showGrip = unhurried(event => { pane.style.cursor = canGrip(event) ? "grab" : ""; });

pane.addEventListener("pointerdown", event => {
  grip = gripAt(event);
  viewer.controls.enabled = grip === null;
  if (grip) pane.setPointerCapture(event.pointerId);
}, {capture: true});
pane.addEventListener("pointermove", event => {
  if (grip) wish({ask: "drag", ...grip, ...rayAt(event)});
  else if (!event.buttons) showGrip(event);
});
for (const end of ["pointerup", "pointercancel"])
  pane.addEventListener(end, () => {
    if (grip) wish({ask: "ranges"});
    grip = null;
    viewer.controls.enabled = true;
  });

// ---------------------------------------------------------------- the camera stays with the mechanism

function corners() {  // of the boxes of all that is shown, as the camera's own axes have them
  const found = [];
  viewer.scene.updateMatrixWorld();
  for (const {meshes} of solids.filter(solid => isShown(solid) && solid.group !== "grid"))
    for (const mesh of meshes) {
      if (!mesh.geometry.boundingBox) mesh.geometry.computeBoundingBox();
      const {min, max} = mesh.geometry.boundingBox;
      for (const x of [min.x, max.x]) for (const y of [min.y, max.y]) for (const z of [min.z, max.z])
        found.push(viewer.camera.parent.worldToLocal(mesh.localToWorld(new THREE.Vector3(x, y, z))));
    }
  return found;
}

function refit() {  // where it has left the picture, and the user has not chosen what to see
  if (moved) return;
  const outside = corners().some(p => {
    const seen = viewer.camera.parent.localToWorld(p).project(viewer.camera);
    return Math.max(Math.abs(seen.x), Math.abs(seen.y)) > 1;
  });
  if (outside) view("fit");
}

extent = corners;
film.refits = true;
