// Curves under the picture, with a cursor that follows the film and that the film follows.
const COLOURS = ["var(--blue)", "var(--orange)", "var(--green)"];
const MARGIN = {left: 46, right: 8, top: 6, bottom: 18};
const HEIGHT = 120;
const ROUND_OFF = 1e-12;  // of the largest value of a figure: less is told as zero
const drawer = document.getElementById("curves");
const panels = [];

function panelOf(data) {
  const figure = element(drawer, "figure", {});
  const caption = element(figure, "figcaption", {});
  element(caption, "b", {textContent: data.label});
  const values = data.lines.map((line, k) => {
    const value = element(caption, "span", {});
    value.style.color = colourOf(data, k);
    return value;
  });
  element(caption, "small", {textContent: `over ${film.curves.name}`});
  element(caption, "button", {type: "button", textContent: "×", title: "take this curve away", onclick: () => remove(panel)});
  const svg = drawing(figure, "svg", {role: "img", "aria-label": data.label});
  const panel = {data, figure, svg, values, scale: null};
  listen(panel);
  return panel;
}

const colourOf = ({lines}, k) => COLOURS[(lines[k].of ?? k) % COLOURS.length];
const isOther = ({lines}, k) => (lines[k].of ?? k) !== k;  // of another motion that is shown too

function listen(panel) {  // the film goes where the pointer is
  const {svg} = panel;
  svg.onpointerdown = event => {
    svg.setPointerCapture(event.pointerId);
    follow(panel, event);
  };
  svg.onpointermove = event => { if (event.buttons & 1) follow(panel, event); };
  svg.addEventListener("wheel", event => {
    event.preventDefault();
    zoomAt(panel, event);
  }, {passive: false});
  svg.ondblclick = () => zoomTo(null);
}

function remove(panel) {
  panels.splice(panels.indexOf(panel), 1);
  panel.figure.remove();
  listSignals();
}

function add(data) {  // the picture begins anew below it
  panels.push(panelOf(data));
  drawCurves();
  listSignals();
}

function ticks(low, high, most) {  // round numbers between two values
  const rough = (high - low) / most || 1;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = decade * [1, 2, 5, 10].find(f => f * decade >= rough);
  const first = Math.ceil(low / step);
  return Array.from({length: Math.floor(high / step + 1e-9) - first + 1}, (_, k) => (first + k) * step);
}

const range = values => {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const room = high - low > 1e-9 * Math.max(Math.abs(low), Math.abs(high)) ? 0 : 0.1 * Math.abs(low) || 1;
  return [low - room, high + room];
};

const briefly = x => String(Number(x.toPrecision(5))).replace("-", "−");

let here = values => valueAt(animator.time, values);  // of what the picture shows
let showAt = x => go(between(x, film.curves.x, film.seconds));
const hasCurves = () => !drawer.hidden && film.curves.x.length > 0;
let zoomed = null;  // ends of the part of the abscissa that is drawn; null: all

function seenRows(x) {  // from just before to just after a part of the abscissa
  const all = film.curves.x.map((_, row) => row);
  const inside = all.filter(row => [row - 1, row, row + 1].some(k => film.curves.x[k] >= x[0] && film.curves.x[k] <= x[1]));
  return inside.length > 1 ? inside : all;
}

function scaleOf(panel, width) {
  const x = zoomed || range(film.curves.x), rows = seenRows(x);
  const y = range(panel.data.lines.flatMap(line => rows.map(row => line.values[row])).filter(v => v !== null));
  const [w, h] = [width - MARGIN.left - MARGIN.right, HEIGHT - MARGIN.top - MARGIN.bottom];
  return {
    x, y, rows,
    across: v => MARGIN.left + (v - x[0]) / (x[1] - x[0]) * w,
    up: v => MARGIN.top + (y[1] - v) / (y[1] - y[0]) * h,
    back: p => Math.min(Math.max(x[0] + (p - MARGIN.left) / w * (x[1] - x[0]), x[0]), x[1]),
  };
}

function drawAxes({svg, scale}, width) {
  const end = HEIGHT - MARGIN.bottom;
  for (const v of ticks(...scale.x, width / 90)) {
    drawing(svg, "line", {class: "grid", x1: scale.across(v), x2: scale.across(v), y1: MARGIN.top, y2: end});
    drawing(svg, "text", {x: scale.across(v), y: HEIGHT - 5, "text-anchor": "middle"}).textContent = briefly(v);
  }
  for (const v of ticks(...scale.y, 4)) {
    drawing(svg, "line", {class: "grid", x1: MARGIN.left, x2: width - MARGIN.right, y1: scale.up(v), y2: scale.up(v)});
    drawing(svg, "text", {x: MARGIN.left - 5, y: scale.up(v) + 4, "text-anchor": "end"}).textContent = briefly(v);
  }
  for (const mark of film.marks || []) {
    const at = valueAt(mark.seconds, film.curves.x);
    if (at < scale.x[0] || at > scale.x[1]) continue;
    const x = scale.across(at);
    const line = drawing(svg, "line", {class: "event", x1: x, x2: x, y1: MARGIN.top, y2: end});
    drawing(line, "title", {}).textContent = `${mark.kind}: ${mark.text}`;
  }
}

function drawPanel(panel) {
  const width = panel.svg.clientWidth;
  panel.svg.replaceChildren();
  panel.scale = scaleOf(panel, width);
  drawAxes(panel, width);
  const inner = {x: MARGIN.left, y: 0, width: width - MARGIN.left - MARGIN.right, height: HEIGHT};
  const paper = drawing(panel.svg, "svg", {...inner, viewBox: `${MARGIN.left} 0 ${inner.width} ${HEIGHT}`});
  panel.data.lines.forEach((line, k) => {
    const points = panel.scale.rows.map(row => line.values[row] === null ? "" : `${panel.scale.across(film.curves.x[row]).toFixed(1)},${panel.scale.up(line.values[row]).toFixed(1)}`);
    const d = points.map((p, row) => p && (points[row - 1] ? "L" : "M") + p).join("");  // a gap where there is none
    const dashes = isOther(panel.data, k) ? {"stroke-dasharray": "6 4"} : {};
    drawing(paper, "path", {d, stroke: colourOf(panel.data, k), ...dashes});
  });
  panel.cursor = drawing(panel.svg, "line", {class: "cursor", y1: MARGIN.top, y2: HEIGHT - MARGIN.bottom});
}

function drawCursors() {
  if (!hasCurves()) return;
  const x = here(film.curves.x);
  for (const panel of panels) {
    const at = panel.scale.across(x);
    panel.cursor.setAttribute("visibility", x >= panel.scale.x[0] && x <= panel.scale.x[1] ? "visible" : "hidden");
    panel.cursor.setAttribute("x1", at);
    panel.cursor.setAttribute("x2", at);
    panel.data.lines.forEach((line, k) => {
      const name = line.name ? `${line.name} ` : "";
      const value = here(line.values), least = ROUND_OFF * Math.max(...panel.scale.y.map(Math.abs));
      const told = value === null ? "–" : briefly(Math.abs(value) < least ? 0 : value);
      panel.values[k].textContent = `${name}${told} ${panel.data.unit}`;
    });
  }
}

function follow(panel, event) {
  showAt(panel.scale.back(event.clientX - panel.svg.getBoundingClientRect().left));
}

function drawCurves() {
  if (hasCurves()) panels.forEach(drawPanel);
}

document.body.classList.toggle("uncurved", !film.curves);
new ResizeObserver(drawCurves).observe(drawer);
