// The view and the time in the page's address: a link, or the page loaded again, shows the same.
const LATER = 300;  // after the last change [ms]
let remembering = 0;

function remember() {
  if (location.protocol === "about:") return;  // a page within another has no address
  clearTimeout(remembering);
  remembering = setTimeout(() => history.replaceState(null, "", hashOf()), LATER);
}

function hashOf() {
  const wish = new URLSearchParams(location.hash.slice(1));
  const {camera, controls} = viewer;
  const set = (name, value) => { if (value === null) wish.delete(name); else wish.set(name, value); };
  const places = [...camera.position.toArray(), ...controls.target.toArray()];
  set("view", moved ? places.map(x => Number(x.toFixed(4))).join("_") : null);
  set("parallel", camera.fov === PARALLEL ? "" : null);
  set("t", animator.duration > 0 && !animator.playing ? Number(animator.time.toFixed(4)) : null);
  const text = wish.toString().replace(/=(?=&|$)/g, "");
  return text ? `#${text}` : location.pathname + location.search;
}

function viewAsAsked(wish) {
  toggleTool("parallel", wish.has("parallel"));
  const places = (wish.get("view") || "").split("_").map(Number);
  if (places.length !== 6 || !places.every(Number.isFinite)) return;
  viewer.camera.position.set(...places.slice(0, 3));
  viewer.controls.target.set(...places.slice(3));
  moved = true;
  viewer.controls.update();
  keepDepths();
  viewer.set_dirty();
}

viewer.controls.addEventListener("end", remember);
slider.addEventListener("change", remember);
