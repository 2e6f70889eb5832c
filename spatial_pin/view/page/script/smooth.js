// Round bodies look round: a mesh is shaded as if its small facets were one surface.
const EDGE = 0.8;  // cosine of 37 degrees: faces that meet at more keep the edge between them

function smoothed(geometry) {  // every corner has the mean normal of those faces about its point that lean as its own does
  const flat = geometry.toNonIndexed(), corners = geometry.index.array, around = new Map();
  flat.computeVertexNormals();  // of the face of every corner
  const own = flat.attributes.normal.array, mean = new Float32Array(own.length);
  corners.forEach((point, k) => { if (around.has(point)) around.get(point).push(3 * k); else around.set(point, [3 * k]); });
  for (const group of around.values())
    for (const k of group)
      for (const j of group)
        if (own[k] * own[j] + own[k + 1] * own[j + 1] + own[k + 2] * own[j + 2] > EDGE)
          for (let i = 0; i < 3; i++) mean[k + i] += own[j + i];
  flat.setAttribute("normal", new THREE.BufferAttribute(mean, 3));  // the shader makes their length 1
  return flat;
}

function smoothMeshes() {
  for (const {meshes} of solids)
    for (const mesh of meshes.filter(m => m.material.flatShading && m.geometry.index)) {
      mesh.geometry = smoothed(mesh.geometry);
      mesh.material.flatShading = false;
    }
}

if (!(viewer.renderer instanceof SoftwareRenderer)) smoothMeshes();
