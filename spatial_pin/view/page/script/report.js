// The figures of a report have a cursor that follows the picture, and that the picture follows.
const picture = document.querySelector(".view iframe");
const figures = [...document.querySelectorAll("figure[data-panels]")].map(figureOf);

function figureOf(figure) {
  const svg = figure.querySelector("svg");
  const panels = JSON.parse(figure.dataset.panels);  // left, top, width, height: parts of the drawing; ends of the abscissa
  const lines = panels.map(() => figure.appendChild(Object.assign(document.createElement("i"), {className: "cursor"})));
  svg.onpointerdown = event => {
    svg.setPointerCapture(event.pointerId);
    follow(svg, panels, event);
  };
  svg.onpointermove = event => { if (event.buttons & 1) follow(svg, panels, event); };
  return {svg, panels, lines};
}

function shownFilm() {  // of the picture, once it is there; undefined where it has no curves to go by
  const page = picture && picture.contentWindow;
  return page && page.film && page.film.curves && page.seek ? page : undefined;
}

function follow(svg, panels, event) {
  const page = shownFilm();
  const box = svg.getBoundingClientRect();
  const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  const at = panels.find(([left, top, width, height]) => y <= top + height && x >= left && x <= left + width);
  if (!page || !at) return;
  const [left, , width, , first, last] = at;
  page.go(page.between(first + (x - left) / width * (last - first), page.film.curves.x, page.film.seconds));
}

function drawCursors() {
  const page = shownFilm();
  if (page) {
    const x = page.between(page.filmTime(), page.film.seconds, page.film.curves.x);
    for (const {svg, panels, lines} of figures) panels.forEach((panel, k) => drawCursor(svg, panel, lines[k], x));
  }
  requestAnimationFrame(drawCursors);
}

function drawCursor(svg, [left, top, width, height, first, last], line, x) {
  const [w, h] = [svg.clientWidth, svg.clientHeight];
  const part = (x - first) / (last - first);
  line.hidden = !(part >= -1e-6 && part <= 1 + 1e-6);
  line.style.left = `${(left + part * width) * w}px`;
  line.style.top = `${top * h}px`;
  line.style.height = `${height * h}px`;
}

if (picture) picture.onmouseenter = () => picture.contentWindow.focus();  // its keys work there
drawCursors();
