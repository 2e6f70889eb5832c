// The curves from nearer: the wheel draws less of the abscissa, or more; a double click all of it.
const NEAREST = 1e-3;  // least part of the abscissa

function zoomAt(panel, event) {
  const whole = range(film.curves.x), [low, high] = zoomed || whole;
  const at = panel.scale.back(event.clientX - panel.svg.getBoundingClientRect().left);
  const part = 1.0015 ** event.deltaY;
  const least = NEAREST * (whole[1] - whole[0]);
  const factor = Math.max(part, least / (high - low));
  const slide = event.deltaX / panel.svg.clientWidth * (high - low);
  const ends = [at + (low - at) * factor + slide, at + (high - at) * factor + slide];
  zoomTo(ends.map(x => Math.min(Math.max(x, whole[0]), whole[1])));
}

function zoomTo(ends) {  // null: all
  const whole = range(film.curves.x);
  zoomed = ends && ends[1] - ends[0] < whole[1] - whole[0] ? ends : null;
  drawCurves();
}
