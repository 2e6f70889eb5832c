// The sliders ask the process that serves this page, one question at a time; see live.py.
const live = heldIn("live");
const panel = below.appendChild(document.getElementById("drive"));
const note = panel.querySelector("header output");
const waiting = [];  // questions; the newest of a kind replaces an older one
let asking = false;
let said = [];  // the lines of the readings

function dialRow(dial) {
  const row = element(document.getElementById("dials"), "label", {title: dial.name});
  element(row, "span", {textContent: dial.name});
  const track = element(row, "div", {});
  const slider = element(track, "input", {type: "range", step: "any", min: 0, max: 1, value: 0});
  const number = element(row, "input", {type: "number", step: "any"});
  element(row, "small", {textContent: dial.unit});
  slider.setAttribute("aria-label", dial.name);
  number.setAttribute("aria-label", `${dial.name}, exact value`);
  const made = {dial, row, track, slider, number, value: 0, stop: null};
  slider.oninput = () => drag(made);
  number.onchange = () => type(made);
  slider.onchange = () => wish({ask: "ranges"});
  return made;
}

function wish(question) {
  const same = waiting.findIndex(q => q.ask === question.ask && q.driver === question.driver);
  if (same >= 0) waiting[same] = question; else waiting.push(question);
  if (!asking) work();
}

function drag(dial) {  // a slider that has stopped is held there until it is moved back
  const value = Number(dial.slider.value);
  if (dial.stop && dial.stop.kind.endsWith("limit") && (value - dial.stop.value) * dial.stop.way >= 0) dial.slider.value = dial.stop.value;
  else wish({ask: "move", driver: dial.dial.name, value});
}

function type(dial) {
  if (dial.number.value === "") { write(dial); return; }
  wish({ask: "move", driver: dial.dial.name, value: Number(dial.number.value)});
  wish({ask: "ranges"});
}

async function work() {
  asking = true;
  while (waiting.length) {
    const question = waiting.shift();
    try {
      obeyed(question, await ask(question));
    } catch (error) {
      waiting.length = 0;
      tell(`no answer from the program that shows this page: ${error.message}`, "error");
    }
  }
  asking = false;
}

async function ask(question) {
  const answer = await fetch("/", {
    method: "POST",
    headers: {"Content-Type": "application/json", "X-Token": live.token},
    body: JSON.stringify(question),
  });
  if (!answer.ok) throw new Error(`${answer.status} ${answer.statusText}`);
  return answer.json();
}

function obeyed(question, answer) {
  if (answer.error) {
    tell(answer.error, "error");
    dials.forEach(write);
    return;
  }
  answer.poses.forEach(place_object);
  viewer.set_dirty();
  if (answer.ranges) for (const dial of dials) stretch(dial, answer.ranges[dial.dial.name]);
  for (const dial of dials) {
    const before = dial.value;
    dial.value = answer.values[dial.dial.name];
    if (question.ask === "move") hold(dial, question, answer.stop, before);
    else if (question.ask !== "ranges") dial.stop = null;
    dial.row.classList.toggle("held", dial.stop !== null);
    write(dial);
  }
  answer.signals.forEach((x, k) => { film.values[k][0] = x; });
  read(answer.says);
  grow(question, answer);
  refit();
  if (["move", "drag"].includes(question.ask)) tell(answer.stop ? answer.stop.text : "", "stop");
  else if (question.ask !== "ranges") tell(answer.note || "", "");
}

function hold(dial, question, stop, before) {
  const own = question.driver === dial.dial.name;
  const way = stop && (Math.sign(question.value - stop.value) || Math.sign(stop.value - before));
  dial.stop = own && stop ? {...stop, way} : null;
}

function place_object([path, pose]) {
  const object = viewer.scene_tree.find(path.split("/").slice(1)).object;
  object.position.set(...pose.slice(0, 3));
  object.quaternion.set(...pose.slice(3, 7));
  if (pose.length > 7) object.scale.set(...pose.slice(7));
}

function write(dial) {  // not over a wish that is still to be answered
  if (waiting.some(q => q.driver === dial.dial.name)) return;
  dial.slider.value = dial.value;
  dial.number.value = dial.value.toFixed(dial.dial.digits).replace(/^-([0.]+)$/, "$1");
}

function stretch(dial, range) {
  [dial.slider.min, dial.slider.max] = range.ends;
  dial.track.querySelectorAll("b").forEach(mark => mark.remove());
  for (const mark of range.marks) {  // the thumb is 16 px wide: its middle goes not quite as far
    const part = (mark.at - range.ends[0]) / (range.ends[1] - range.ends[0]);
    const tick = element(dial.track, "b", {title: mark.text, className: mark.kind.replace(" ", "-")});
    tick.style.left = `calc(8px + ${part} * (100% - 16px))`;
  }
}

function read(lines) {
  const parent = document.getElementById("readings");
  while (said.length < lines.length) said.push(element(parent, "output", {}));
  said.forEach((line, k) => { line.textContent = lines[k] || ""; });
}

function tell(text, kind) {
  note.textContent = text;
  note.className = kind;
}

function press(button, question) {
  document.getElementById(button).onclick = () => { tell("…", ""); wish(question); };
}

const dials = live.dials.map(dialRow);
document.getElementById("mode").hidden = !live.modes;
press("mode", {ask: "mode"});
press("home", {ask: "home"});
document.getElementById("limits").hidden = !live.limits;
const keep = document.querySelector("#limits input");
keep.checked = live.keeps;
keep.onchange = () => wish({ask: "limits", keep: keep.checked});
panel.onsubmit = event => event.preventDefault();
panel.addEventListener("keydown", event => event.stopPropagation());  // they are the sliders'
wish(live.limits ? {ask: "limits", keep: keep.checked} : {ask: "ranges"});
