// Meshes are shaded round, as if their small facets were one surface; lines mark the edges of links.
const EDGE = 0.8;  // cosine of 37 degrees: faces that meet at more have an edge between them
const DARK_LINK = 0.25;  // brightness below which edges are drawn lighter than the link

function facesOf({attributes: {position}, index}) {  // points that lie in one place are one
  const {array: p, count} = position, places = new Map(), same = new Uint32Array(count);
  for (let k = 0; k < count; k++) {
    const place = `${p[3 * k]} ${p[3 * k + 1]} ${p[3 * k + 2]}`;
    if (!places.has(place)) places.set(place, k);
    same[k] = places.get(place);
  }
  const corners = Uint32Array.from(index.array, k => same[k]), normals = new Float32Array(corners.length);
  for (let k = 0; k < corners.length; k += 3) {
    const [a, b, c] = [3 * corners[k], 3 * corners[k + 1], 3 * corners[k + 2]];
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    const size = Math.sqrt(x * x + y * y + z * z) || 1;
    normals.set([x / size, y / size, z / size], k);
  }
  return {corners, normals, count};
}

const leanOf = (n, j, k) => n[j] * n[k] + n[j + 1] * n[k + 1] + n[j + 2] * n[k + 2];  // cosine between faces, by their first corners

function smoothed(geometry, {corners, normals, count}) {  // a corner has the mean normal of the faces about its point that lean as its own does
  const mean = new Float32Array(3 * corners.length), first = new Uint32Array(count + 1), about = new Uint32Array(corners.length);
  for (const point of corners) first[point + 1]++;
  for (let k = 0; k < count; k++) first[k + 1] += first[k];
  const free = first.slice();
  corners.forEach((point, k) => { about[free[point]++] = k - k % 3; });
  corners.forEach((point, k) => {
    const face = k - k % 3;
    for (let i = first[point]; i < first[point + 1]; i++)
      if (leanOf(normals, face, about[i]) > EDGE) for (let d = 0; d < 3; d++) mean[3 * k + d] += normals[about[i] + d];
  });
  const flat = geometry.toNonIndexed();
  return flat.setAttribute("normal", new THREE.BufferAttribute(mean, 3));  // the shader makes their length 1
}

function edgesOf({attributes: {position: {array}}}, {corners, normals, count}) {  // ends of the lines along which two faces meet at an angle
  const open = new Map(), ends = [];
  corners.forEach((a, k) => {
    const face = k - k % 3, b = corners[face + (k + 1) % 3], line = Math.min(a, b) * count + Math.max(a, b);
    if (open.has(line) && leanOf(normals, open.get(line), face) < EDGE)
      for (const end of [a, b]) ends.push(array[3 * end], array[3 * end + 1], array[3 * end + 2]);
    open.set(line, face);
  });
  return ends;
}

function outline(mesh, ends) {
  const {r, g, b} = mesh.material.color, dark = 0.3 * r + 0.6 * g + 0.1 * b < DARK_LINK;
  const material = new THREE.LineBasicMaterial({color: dark ? 0xffffff : 0, transparent: true, opacity: dark ? 0.3 : 0.4});
  const lines = new THREE.LineSegments(new THREE.BufferGeometry(), material);
  lines.geometry.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
  Object.assign(mesh.material, {polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1});  // lines lie before faces
  return mesh.add(lines).children.at(-1);
}

function drawEdges() {
  const lines = [];
  for (const {meshes, group} of solids)
    for (const mesh of meshes.filter(m => m.geometry.index)) {
      const {geometry, material} = mesh, faces = facesOf(geometry);
      if (material.flatShading) Object.assign(mesh, {geometry: smoothed(geometry, faces)}).material.flatShading = false;
      const ends = group === "links" && material.opacity === 1 ? edgesOf(geometry, faces) : [];
      if (ends.length) lines.push(outline(mesh, ends));
    }
  const node = {set visible(shown) { for (const line of lines) line.visible = shown; }};
  solids.push({group: "edges", name: "edges", node, meshes: []});
}

if (!(viewer.renderer instanceof SoftwareRenderer)) drawEdges();
