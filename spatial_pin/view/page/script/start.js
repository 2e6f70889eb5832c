// What the address asks for, and the picture again and again.
function obey() {  // #t=1.5 stops there; #view=... looks from there; #bare hides what can be clicked; #controls shows meshcat's own
  const wish = new URLSearchParams(location.hash.slice(1));
  document.body.classList.toggle("bare", wish.has("bare"));
  dress();
  document.body.classList.toggle("controls", wish.has("controls"));
  document.body.classList.toggle("still", animator.duration === 0);
  viewAsAsked(wish);
  if (wish.has("t") && animator.duration > 0) go(Number(wish.get("t")));
}

function update() {
  say();
  place();
  measure();
  keepUp();
  drawTriad();
  drawCursors();
  tellInspected();
  watchShadow();
  if (animator.playing) slider.value = animator.time;
  button.textContent = animator.playing ? "❚❚" : "▶";
  requestAnimationFrame(update);
}

addEventListener("hashchange", () => { obey(); share(); });
if (viewer.renderer instanceof SoftwareRenderer) seek(0);  // a still until it is played
obey();
say();
share();  // among what is said
update();
