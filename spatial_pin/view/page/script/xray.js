// Links that one sees through, so that pairs within housings show.
const GLASS = 0.22;  // opacity of a link that is solid otherwise

function setXray(on) {
  for (const {meshes} of solids.filter(solid => solid.group === "links"))
    for (const {material} of meshes) {
      material.userData.solid ||= {opacity: material.opacity, transparent: material.transparent, depthWrite: material.depthWrite};
      const {solid} = material.userData;
      Object.assign(material, on ? {opacity: GLASS * solid.opacity, transparent: true, depthWrite: false} : solid);
      material.needsUpdate = true;
    }
  viewer.set_dirty();
}
