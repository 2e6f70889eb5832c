// A plane across an axis of the world: links before it are not drawn, and where it cuts them they are hatched.
const CUT = ["links", "springs", "ghosts", "clearance"];  // groups that are cut; signs and paths stay whole
// The far side of a closed body is seen through the cut, and drawn without light: it looks like the cut itself.
const HATCHED = `#include <dithering_fragment>
  if (!gl_FrontFacing) gl_FragColor = vec4(diffuse * (mod(gl_FragCoord.x + gl_FragCoord.y, 10.0) < 1.5 ? 0.3 : 0.82), opacity);`;
const section = {on: false, axis: 1, turned: false, plane: new THREE.Plane()};
const sectionPanel = document.getElementById("section");
const sectionSlider = sectionPanel.querySelector("[type=range]");

const isBeyondCut = point => section.on && section.plane.distanceToPoint(point) < 0;
const isCutOff = ({point, object}) => CUT.includes(object.userData.solid.group) && isBeyondCut(point);
const placeInWorld = metres => root.localToWorld(new THREE.Vector3(...film.world[section.axis]).multiplyScalar(metres));

function hatch(shader) {
  shader.fragmentShader = shader.fragmentShader.replace("#include <dithering_fragment>", HATCHED);
}

function setSection(on) {
  section.on = on;
  sectionPanel.hidden = !on;
  viewer.renderer.localClippingEnabled = true;
  for (const {meshes} of solids.filter(solid => CUT.includes(solid.group)))
    for (const {material, children} of meshes) {
      for (const lines of children) lines.material.visible = !on;  // those of the far side would be seen in the cut
      material.clippingPlanes = on ? [section.plane] : null;
      material.onBeforeCompile = on ? hatch : () => {};
      material.needsUpdate = true;
    }
  if (on) cutAcross(section.axis);
  viewer.set_dirty();
}

function cutAcross(axis) {  // through the middle of what there is to be seen
  section.axis = axis;
  const heights = extent().map(p => inMetres(placeInWorld(0), viewer.camera.parent.localToWorld(p.clone()))[axis]);
  const [low, high] = [Math.min(...heights), Math.max(...heights)];
  Object.assign(sectionSlider, {min: low, max: high, step: "any"});
  sectionSlider.value = (low + high) / 2;
  section.turned = ofCamera(film.world[axis]).dot(viewer.camera.position.clone().sub(viewer.controls.target)) < 0;  // open towards the eye
  cutAt();
}

function cutAt() {
  const normal = ofCamera(film.world[section.axis]).multiplyScalar(section.turned ? 1 : -1);
  section.plane.setFromNormalAndCoplanarPoint(normal, placeInWorld(Number(sectionSlider.value)));
  const [low, high, value] = [sectionSlider.min, sectionSlider.max, sectionSlider.value].map(Number);
  const step = 10 ** Math.floor(Math.log10((high - low) / 300 || 1));  // finer places are not told
  sectionPanel.querySelector("output").textContent = `${"xyz"[section.axis]} = ${lengthWords(Math.round(value / step) * step, high - low)}`;
  for (const one of sectionPanel.querySelectorAll("[data-axis]")) one.classList.toggle("on", Number(one.dataset.axis) === section.axis);
  viewer.set_dirty();
}

for (const one of sectionPanel.querySelectorAll("[data-axis]")) one.onclick = () => cutAcross(Number(one.dataset.axis));
sectionPanel.querySelector("[data-turn]").onclick = () => { section.turned = !section.turned; cutAt(); };
sectionSlider.oninput = cutAt;
sectionSlider.onkeydown = event => { if (event.key.startsWith("Arrow") || ["Home", "End"].includes(event.key)) event.stopPropagation(); };
