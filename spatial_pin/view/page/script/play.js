// Playing: speed, what happens at the end, single frames.
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const ENDINGS = {
  again: {sign: "↻", title: "begins again at the end (R)"},
  back: {sign: "⇄", title: "goes to and fro (R)"},
  stop: {sign: "⇥", title: "stops at the end (R)"},
};
const playing = {speed: 1, ending: "again", way: 1};
const speeds = document.querySelector("#player select");
const ending = document.getElementById("ending");

animator.update = () => {  // meshcat's own knows neither speed nor ends
  if (!animator.playing) return;
  show(later(animator.time, animator.clock.getDelta() * playing.speed));
};

function later(seconds, passed) {
  const end = animator.duration;
  const wish = seconds + playing.way * passed;
  if (wish >= 0 && wish <= end || end === 0) return Math.min(wish, end);
  if (playing.ending === "back") {
    playing.way = wish > end ? -1 : 1;
    return wish > end ? Math.max(2 * end - wish, 0) : Math.min(-wish, end);
  }
  if (playing.ending === "again") return wish % end;
  animator.pause();
  return end;
}

function toggle() {
  remember();
  if (animator.playing) { animator.pause(); return; }
  if (playing.ending === "stop" && animator.time >= animator.duration) seek(0);
  animator.play();
}

function step(frames) {  // to a sample of the motion, some away from where the film stands
  const tiny = 1e-6 * (animator.duration || 1);
  const here = film.seconds.findIndex(s => s >= animator.time - tiny);
  const first = here < 0 ? film.seconds.length - 1 : here;
  const onIt = Math.abs(film.seconds[first] - animator.time) <= tiny;
  go(film.seconds[Math.min(Math.max(first + frames - (!onIt && frames > 0), 0), film.seconds.length - 1)]);
}

function go(seconds) {
  seek(seconds);
  slider.value = animator.time;
  remember();
}

function setSpeed(speed) {
  playing.speed = speed;
  speeds.value = speed;
}

function faster(way) {
  const k = SPEEDS.indexOf(playing.speed) + way;
  if (k in SPEEDS) setSpeed(SPEEDS[k]);
}

function setEnding(name) {
  playing.ending = name;
  playing.way = 1;
  ending.textContent = ENDINGS[name].sign;
  ending.title = ENDINGS[name].title;
}

function nextEnding() {
  const names = Object.keys(ENDINGS);
  setEnding(names[(names.indexOf(playing.ending) + 1) % names.length]);
}

function markSlider() {  // limits and the like; the thumb is 16 px wide: its middle goes not quite as far
  slider.max = animator.duration;
  for (const mark of film.marks || []) {
    const tick = element(slider.parentNode, "b", {title: `${mark.kind}: ${mark.text}`});
    tick.style.left = `calc(8px + ${mark.seconds / (animator.duration || 1)} * (100% - 16px))`;
  }
}

for (const speed of SPEEDS) element(speeds, "option", {value: speed, textContent: `${speed}×`});
speeds.onchange = () => { setSpeed(Number(speeds.value)); speeds.blur(); };
ending.onclick = nextEnding;
button.onclick = toggle;
slider.oninput = () => seek(Number(slider.value));
for (const one of document.querySelectorAll("[data-step]"))
  one.onclick = event => step(Number(one.dataset.step) * (event.shiftKey ? 10 : 1));
setSpeed(1);
setEnding("again");
markSlider();
