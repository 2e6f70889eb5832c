// Keys work wherever in the page the focus is.
const KEYS = {
  " ": toggle,
  ArrowLeft: event => step(event.shiftKey ? -10 : -1),
  ArrowRight: event => step(event.shiftKey ? 10 : 1),
  Home: () => go(0),
  End: () => go(animator.duration),
  "+": () => faster(1),
  "-": () => faster(-1),
  r: nextEnding,
  1: () => view("front"),
  2: () => view("top"),
  3: () => view("side"),
  4: () => view("iso"),
  5: () => view("first"),
  f: () => view("fit"),
  p: () => toggleTool("parallel"),
  x: () => toggleTool("xray"),
  s: () => toggleTool("section"),
  t: toggleChase,
  l: () => toggleTool("parts"),
  i: () => toggleTool("inspector"),
  m: () => toggleTool("ruler"),
  c: () => toggleTool("curves"),
};
const OF_TIME = [" ", "ArrowLeft", "ArrowRight", "Home", "End", "+", "-", "r"];

function isTyped(event) {  // into a field, or meant for the button that has the focus
  const on = event.target;
  if (!on.matches) return false;
  if (on.matches("textarea, select, input:not([type=range]):not([type=checkbox])")) return true;
  return on.matches("button, input[type=checkbox]") && [" ", "Enter"].includes(event.key);
}

function keyed(event) {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.ctrlKey || event.metaKey || event.altKey || isTyped(event) || !(key in KEYS)) return;
  if (OF_TIME.includes(key) && animator.duration === 0) return;
  event.preventDefault();
  KEYS[key](event);
}

addEventListener("keydown", keyed);
