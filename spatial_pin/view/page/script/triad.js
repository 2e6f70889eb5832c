// The axes of the world as they are seen now; a click on one looks along it.
const ARM = 26;  // [pixels]
const AXES = [["x", "#d55e00"], ["y", "#009e73"], ["z", "#0072b2"]];
const triad = {svg: document.getElementById("triad"), seen: ""};
const ends = AXES.flatMap(([name, colour], axis) => [1, -1].map(way => endOf(name, colour, axis, way)));

function endOf(name, colour, axis, way) {
  const line = drawing(triad.svg, "line", {stroke: colour});
  const knob = drawing(triad.svg, "g", {});
  drawing(knob, "title", {}).textContent = `seen from ${way < 0 ? "−" : "+"}${name}`;
  drawing(knob, "circle", {r: way > 0 ? 8 : 5, stroke: colour, fill: way > 0 ? colour : "var(--sky)"});
  if (way > 0) drawing(knob, "text", {y: 4}).textContent = name;
  line.setAttribute("visibility", way > 0 ? "inherit" : "hidden");
  const direction = ofCamera(film.world[axis]).multiplyScalar(way);
  knob.onclick = () => lookFrom(direction);
  return {line, knob, direction};
}

function drawTriad() {  // only when it has turned
  const {matrixWorldInverse} = viewer.camera;
  const seen = ends.map(({direction}) => direction.clone().transformDirection(matrixWorldInverse));
  const words = seen.map(d => `${d.x.toFixed(3)} ${d.y.toFixed(3)}`).join();
  if (words === triad.seen) return;
  triad.seen = words;
  ends.forEach(({line, knob}, k) => {
    const [x, y] = [ARM * seen[k].x, -ARM * seen[k].y];
    knob.setAttribute("transform", `translate(${x} ${y})`);
    line.setAttribute("x2", x);
    line.setAttribute("y2", y);
  });
  const nearestLast = ends.map((end, k) => [seen[k].z, end]).sort(([a], [b]) => a - b);
  for (const [, {line, knob}] of nearestLast) triad.svg.append(line, knob);
}
