// The buttons that switch something on: parallel lines, the list of links, the ruler, the curves.
const OPENED = {
  parts: open => { document.getElementById("parts").hidden = !open; },
  ruler: setRuler,
  parallel: setParallel,
  xray: setXray,
  chase: setChase,
  section: setSection,
  inspector: setInspector,
  curves: open => { drawer.hidden = !open; drawCurves(); },
};

function toggleTool(name, wish) {  // or shut; as it is not, unless it is said how
  const tool = document.querySelector(`[data-opens=${name}]`);
  if (name === "curves" && !film.curves) return;
  const on = wish === undefined ? !tool.classList.contains("on") : wish;
  tool.classList.toggle("on", on);
  tool.setAttribute("aria-pressed", on);
  OPENED[name](on);
}

for (const one of document.querySelectorAll("[data-opens]")) one.onclick = () => toggleTool(one.dataset.opens);
if (film.curves && film.curves.open) toggleTool("curves", true);
