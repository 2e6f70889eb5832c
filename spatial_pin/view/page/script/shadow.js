// The shadow of the machine on the ground, where it can be drawn fast enough.
const DARK = 0.16;  // of the shadow: colours and grid are seen in it
const SUN = [0.5, -0.35, 3];  // from nearly above: the shadow tells where over the ground a link is
const SIDE = 1.7;  // half of what has a shadow, by the size of the scene
const SLOW = 60, PATIENCE = 20;  // time between two pictures [ms], and how many such in a row are too many
const pace = {slow: 0, last: 0};

function drawsSlowly() {  // by a processor that has other things to do
  const gl = viewer.renderer.getContext(), told = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

function sun() {
  const light = new THREE.DirectionalLight(0xffffff, 0);  // links keep their colours
  light.position.set(...SUN);
  light.castShadow = true;
  light.shadow.mapSize.set(2048, 2048);
  light.shadow.bias = -0.002;
  Object.assign(light.shadow.camera, {left: -SIDE, right: SIDE, bottom: -SIDE, top: SIDE, near: 0.5, far: 7});
  return light;
}

function ground() {
  const plane = new THREE.Mesh(new THREE.PlaneGeometry(8, 8), new THREE.ShadowMaterial({opacity: DARK}));
  viewer.scene.updateMatrixWorld();
  plane.position.z = new THREE.Box3().setFromObject(nodeAt(film.grid)).min.y - 1e-3;  // the scene has z up, three.js y
  plane.receiveShadow = true;
  return plane;
}

function castShadows() {
  const node = viewer.scene.add(new THREE.Group()).children.at(-1);
  node.add(sun(), ground());
  viewer.scene.traverse(object => {
    const {solid} = object.userData;
    if (!solid) return;
    object.castShadow = ["links", "springs"].includes(solid.group) && object.material.opacity === 1;
    object.receiveShadow = false;
  });
  solids.push({group: "shadow", name: "shadow", node, meshes: []});
  if (film.shadow === false || film.shadow === null && drawsSlowly()) hidden.group.add("shadow");
}

function watchShadow() {  // it is not worth a picture that jerks; who asks for it again has it
  const now = performance.now(), box = document.querySelector("#parts [data-group=shadow]");
  const slow = animator.playing && now - pace.last > SLOW;
  pace.slow = slow ? pace.slow + 1 : 0;
  pace.last = now;
  if (pace.slow < PATIENCE || !box || !box.checked || film.shadow !== null) return;
  box.checked = false;
  setShown("group", "shadow", false);
  film.shadow = false;
}

if (!(viewer.renderer instanceof SoftwareRenderer)) castShadows();
listParts();
showParts();
