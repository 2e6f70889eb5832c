// A dark page where the reader's system is dark; pictures, reports and notebooks stay light.
const night = matchMedia("(prefers-color-scheme: dark)");

function dress() {
  const dark = night.matches && top === window && !document.body.classList.contains("bare");
  document.body.classList.toggle("dark", dark);
  const colour = name => new THREE.Color(getComputedStyle(document.body).getPropertyValue(name).trim());
  const sky = colour("--sky");
  for (const key of ["top_color", "bottom_color"]) viewer.set_property(["Background"], key, sky.toArray());
  const [red, green, blue] = sky.toArray().map(c => Math.round(255 * c));
  viewer.renderer.sky = (255 << 24 | blue << 16 | green << 8 | red) >>> 0;  // read where there is no WebGL
  nodeAt(film.grid).traverse(object => { if (object.material) object.material.color.copy(colour("--grid")); });
  viewer.set_dirty();
}

night.onchange = dress;
