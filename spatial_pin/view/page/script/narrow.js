// In a narrow window the figures of a report are drawn narrower, and their words no smaller than can be read.
const FULL = 700;  // width from which a figure is shown as it was drawn [pixels]
const POINT = 4 / 3;  // [pixels]
const READABLE = 0.85;  // least size of words relative to that on paper
const ANCHORS = [  // what of the words stays where it is: parts of their width and height
  ["[id^=xtick_] > [id^=text_]", 0.5, 0],
  ["[id^=ytick_] > [id^=text_]", 1, 0.5],
  ["[id^=matplotlib\\.axis_] > [id^=text_]", 0.5, 0.5],
  ["[id^=axes_] > [id^=text_]", 0, 1],
  ["[id^=legend_]", 1, 1],
];

function fitFigure(svg, full) {
  const {width, height} = svg.viewBox.baseVal;  // [points]
  const across = svg.parentNode.clientWidth / (POINT * width);
  const narrow = full > innerWidth && across < READABLE;
  const up = svg.parentNode.dataset.panels ? READABLE : across;  // a path keeps its shape
  svg.setAttribute("preserveAspectRatio", narrow ? "none" : "xMidYMid");
  svg.style.height = narrow ? `${up * POINT * height}px` : "";
  svg.style.overflow = narrow ? "visible" : "";
  for (const [selector, x, y] of ANCHORS)
    for (const words of svg.querySelectorAll(selector))
      enlarge(words, x, y, narrow ? [READABLE / across, READABLE / up] : [1, 1]);
}

function enlarge(words, x, y, [across, up]) {
  words.removeAttribute("transform");
  if (across === 1 && up === 1) return;
  const box = words.getBBox();
  const [left, top] = [box.x + x * box.width, box.y + y * box.height];
  words.setAttribute("transform", `translate(${left} ${top}) scale(${across} ${up}) translate(${-left} ${-top})`);
}

function fitFigures(full = FULL) {
  for (const svg of document.querySelectorAll("figure > svg")) fitFigure(svg, full);
}

addEventListener("resize", () => fitFigures());
addEventListener("beforeprint", () => fitFigures(0));  // as it was drawn
addEventListener("afterprint", () => fitFigures());
fitFigures();
