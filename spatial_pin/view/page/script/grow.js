// Curves of a mechanism that is moved by hand: they grow by what it comes to.
const MOST_POINTS = 5000;  // the oldest go
const lines = panels.flatMap(panel => panel.data.lines);

here = values => values[values.length - 1];
showAt = x => { if (live.over) wish({ask: "move", driver: live.over, value: x}); };

function addPoint(x, values) {
  film.curves.x.push(x);
  lines.forEach((line, k) => line.values.push(values[k]));
  for (const list of [film.curves.x, ...lines.map(line => line.values)]) if (list.length > MOST_POINTS) list.shift();
}

function grow({ask}, answer) {
  if (!lines.length) return;
  const {x} = film.curves, values = answer.points.flat();
  const next = live.over ? answer.values[live.over] : x.length;
  if (x.length && lines.every((line, k) => here(line.values) === values[k])) return;  // it stands still
  if (x.length && ["home", "mode"].includes(ask)) addPoint(next, values.map(() => null));  // a jump is no line
  addPoint(live.over ? next : film.curves.x.length, values);
  drawCurves();
}
