// Draws the scene where WebGL is missing: every triangle into a picture that knows its depths.
const COARSER = 0.75;  // pixels drawn for one of the screen: half as many to fill
const LIGHTS = [[0.3, 0.8, 0.5, 0.45], [-0.7, 0.4, -0.2, 0.2]];  // direction, strength
const AMBIENT = 0.5;

function hasWebGL() {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2") || canvas.getContext("webgl");
  if (context) context.getExtension("WEBGL_lose_context")?.loseContext();
  return Boolean(context);
}

function rendererWithoutWebGL() {  // undefined where there is WebGL
  if (hasWebGL()) return undefined;
  const note = document.createElement("p");
  note.id = "warning";
  note.textContent = "This browser has no WebGL: the picture is drawn without it, coarser and slower.";
  document.getElementById("says").append(note);
  return new SoftwareRenderer();
}

class SoftwareRenderer {
  constructor() {
    this.domElement = document.createElement("canvas");
    this.shadowMap = {};
    this.sky = 0xffffffff;  // alpha, blue, green, red
    this.paper = this.domElement.getContext("2d");
    document.getElementById("meshcat-pane").append(this.domElement);
    this.setSize(1, 1);
  }

  setPixelRatio() {}

  setSize(width, height) {
    Object.assign(this.domElement.style, {width: `${width}px`, height: `${height}px`});
    this.width = this.domElement.width = Math.max(1, Math.round(COARSER * width));
    this.height = this.domElement.height = Math.max(1, Math.round(COARSER * height));
    this.image = this.paper.createImageData(this.width, this.height);
    this.depth = new Float32Array(this.width * this.height);
  }

  render(scene, camera) {
    new Uint32Array(this.image.data.buffer).fill(this.sky);
    this.depth.fill(Infinity);
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    const toScreen = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse);
    const found = [];
    scene.traverseVisible(object => { if (object.geometry && object.material) found.push(object); });
    const late = object => 2 * !object.material.depthTest + (object.material.opacity < 1);
    for (const object of found.sort((a, b) => late(a) - late(b))) this.draw(object, toScreen);
    this.paper.putImageData(this.image, 0, 0);
  }

  draw(object, toScreen) {
    const world = worldPoints(object);
    const screen = world.map(p => this.onScreen(p, toScreen));
    const corners = object.geometry.index ? object.geometry.index.array : world.map((_, k) => k);
    const {color, opacity, depthTest, clippingPlanes} = object.material;
    const plane = clippingPlanes && clippingPlanes[0];
    const rgb = [color.r, color.g, color.b].map(c => 255 * c);
    if (object.isLineSegments)
      for (let k = 0; k + 1 < corners.length; k += 2) this.line(screen[corners[k]], screen[corners[k + 1]], rgb);
    else if (object.isMesh)
      for (let k = 0; k + 2 < corners.length; k += 3) {
        const abc = [corners[k], corners[k + 1], corners[k + 2]];
        const shade = shadeOf(...abc.map(c => world[c]));
        const room = plane && abc.map(c => plane.distanceToPoint(world[c]));
        this.triangle(abc.map(c => screen[c]), rgb.map(c => c * shade), opacity, depthTest, room);
      }
  }

  onScreen(point, toScreen) {  // [pixels], and depth; null behind the camera
    const p = new THREE.Vector4(point.x, point.y, point.z, 1).applyMatrix4(toScreen);
    if (p.w < 1e-3) return null;
    return [(p.x / p.w + 1) / 2 * this.width, (1 - p.y / p.w) / 2 * this.height, p.z / p.w];
  }

  triangle(points, rgb, opacity, depthTest, room) {  // room: of its corners behind a plane that cuts
    if (points.includes(null) || room && Math.max(...room) < 0) return;
    const [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = points;
    const area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay);
    if (Math.abs(area) < 1e-9) return;
    const top = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5));
    const bottom = Math.min(this.height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
    const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5));
    const right = Math.min(this.width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5));
    for (let y = top; y <= bottom; y++)
      for (let x = left; x <= right; x++) {
        const [px, py] = [x + 0.5 - ax, y + 0.5 - ay];
        const u = (px * (cy - ay) - (cx - ax) * py) / area;
        const v = ((bx - ax) * py - px * (by - ay)) / area;
        if (room && room[0] + u * (room[1] - room[0]) + v * (room[2] - room[0]) < 0) continue;
        if (u >= 0 && v >= 0 && u + v <= 1) this.dot(x, y, az + u * (bz - az) + v * (cz - az), rgb, opacity, depthTest);
      }
  }

  line(from, to, rgb) {
    if (!from || !to) return;
    const steps = Math.min(Math.ceil(Math.max(Math.abs(to[0] - from[0]), Math.abs(to[1] - from[1]))), 4000);
    for (let k = 0; k <= steps; k++) {
      const [x, y, z] = from.map((a, i) => a + (steps ? k / steps : 0) * (to[i] - a));
      if (x >= 0 && y >= 0 && x < this.width && y < this.height) this.dot(Math.floor(x), Math.floor(y), z, rgb, 1, true);
    }
  }

  dot(x, y, z, rgb, opacity, depthTest) {
    const place = y * this.width + x;
    if (depthTest && z >= this.depth[place]) return;
    if (depthTest && opacity === 1) this.depth[place] = z;
    const data = this.image.data;
    for (let k = 0; k < 3; k++) data[4 * place + k] += opacity * (rgb[k] - data[4 * place + k]);
  }
}

function worldPoints(object) {
  const positions = object.geometry.attributes.position;
  return Array.from({length: positions.count},
    (_, k) => new THREE.Vector3().fromBufferAttribute(positions, k).applyMatrix4(object.matrixWorld));
}

function shadeOf(a, b, c) {  // both sides are lit alike
  const normal = b.clone().sub(a).cross(c.clone().sub(a)).normalize();
  return LIGHTS.reduce((sum, [x, y, z, strength]) => sum + strength * Math.abs(normal.x * x + normal.y * y + normal.z * z), AMBIENT);
}
