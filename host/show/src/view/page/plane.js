// ---- stiffness and damping ----------------------------------------------------------------------------------------
const MODES = ["off", "full", "washout"], NAMES = { off: "off", full: "full", washout: "washed out" };
// While a gain is typed it stands as it is typed, until it is refused.
function gainsShown(anew) {
  const count = view.walls.length;
  if ($("wall").options.length !== count) $("wall").replaceChildren(...view.walls.map((_, i) => new Option("wall " + i, i)));
  $("wall").hidden = count < 2;
  view.wall = Math.min(view.wall, Math.max(0, count - 1)); $("wall").value = view.wall;
  const wall = view.walls[view.wall]; if (!wall) return;
  for (const id of ["stiffness", "damping"]) if (anew || document.activeElement !== $(id)) $(id).value = +wall[id].toPrecision(4);
  for (const mode of MODES) $("ff-" + mode).classList.toggle("on", wall.feed_forward === mode);
  requestDraw();
}
function sendGains(change, throttled) {
  const { stiffness, damping, feed_forward } = { ...view.walls[view.wall], ...change };
  const message = { do: "gains", wall: view.wall, stiffness, damping, feed_forward, beyond: $("beyond").checked };
  throttled ? sometimes(message) : say(message);
}
for (const mode of MODES) $("ff-" + mode).onclick = () => sendGains({ feed_forward: mode });
for (const id of ["stiffness", "damping"]) $(id).onchange = () => { const value = $(id).valueAsNumber; if (value >= 0) sendGains({ [id]: value }); };
$("wall").onchange = () => { view.wall = +$("wall").value; gainsShown(); };
function nice(most) { const power = 10 ** Math.floor(Math.log10(most)); return [.1, .2, .5, 1].map(n => n * power).find(step => most / step <= 6.5) || 2 * power; }
const tick = value => String(+value.toPrecision(4));
function drawPlane() {
  const [c, w, h] = fresh($("plane")), wall = view.walls[view.wall];
  if (!wall) { c.fillStyle = palette.dim; c.fillText("no wall in this scene", 12, 24); return; }
  const plane = view.plane && view.plane.wall === view.wall ? view.plane : null;
  let [kdTop, kpTop] = [wall.damping * 1.3 || 1, wall.stiffness * 1.3 || 1];
  if (plane) for (const mode of MODES) for (const p of plane[mode]) { kdTop = Math.max(kdTop, p.kd * 1.08); kpTop = Math.max(kpTop, p.kp * 1.12); }
  // The picture does not shrink or grow under a finger.
  if (turning) [kdTop, kpTop] = turning.tops; else view.tops = [kdTop, kpTop];
  const left = w > 900 ? 64 : 50, bottom = w > 900 ? 38 : 32, right = w - 10, top = 8, foot = h - bottom;
  const X = kd => left + kd / kdTop * (right - left), Y = kp => foot - kp / kpTop * (foot - top);
  view.planeFrame = { X, Y, from: (px, py) => [Math.max(0, (px - left) / (right - left) * kdTop), Math.max(0, (foot - py) / (foot - top) * kpTop)] };
  c.fillStyle = palette.dim; c.strokeStyle = palette.line; c.lineWidth = 1; c.textAlign = "center";
  for (let kd = 0, step = nice(kdTop); kd <= kdTop; kd += step) { c.beginPath(); c.moveTo(X(kd), top); c.lineTo(X(kd), foot); c.stroke(); c.fillText(tick(kd), X(kd), foot + 15); }
  c.textAlign = "right";
  for (let kp = 0, step = nice(kpTop); kp <= kpTop; kp += step) { c.beginPath(); c.moveTo(left, Y(kp)); c.lineTo(right, Y(kp)); c.stroke(); c.fillText(kpTop > 2000 ? tick(kp / 1000) : tick(kp), left - 6, Y(kp) + 4); }
  c.textAlign = "right"; c.fillText("damping, N s/m", right, foot + (w > 900 ? 34 : 29));
  c.save(); c.translate(w > 900 ? 16 : 12, top + 4); c.rotate(-Math.PI / 2); c.fillText(kpTop > 2000 ? "stiffness, kN/m" : "stiffness, N/m", 0, 0); c.restore();
  c.textAlign = "left";
  if (plane) {
    for (const mode of MODES) {
      const mine = wall.feed_forward === mode; c.strokeStyle = c.fillStyle = palette[mode]; c.lineWidth = mine ? 3 : 1.3;
      c.beginPath(); plane[mode].forEach((p, i) => i ? c.lineTo(X(p.kd), Y(p.kp)) : c.moveTo(X(p.kd), Y(p.kp))); c.stroke();
      if (mine) { c.lineTo(X(0), Y(0)); c.closePath(); c.globalAlpha = .13; c.fill(); c.globalAlpha = 1; }
    }
    let y = top + 16;
    for (const mode of MODES) { c.textAlign = "right"; c.fillStyle = palette[mode]; c.fillText("feed-forward " + NAMES[mode] + " ━", right - 4, y); y += w > 900 ? 20 : 16; }
    c.textAlign = "left";
  } else { c.fillStyle = palette.dim; c.fillText("the boundary is worked out where the tip is nearest to this wall", left + 8, top + 16); }
  const stable = plane ? wall.stiffness <= below(plane[wall.feed_forward], wall.damping) : true;
  document.body.dataset.stable = stable;
  c.fillStyle = stable ? palette.ink : palette.bad; c.strokeStyle = palette.card; c.lineWidth = 3;
  c.beginPath(); c.arc(X(wall.damping), Y(wall.stiffness), 9, 0, 2 * Math.PI); c.fill(); c.stroke();
  if (!stable) { c.fillStyle = palette.bad; c.fillText("predicted to be unstable", Math.min(X(wall.damping) + 14, w - 160), Y(wall.stiffness) - 10); }
}
function below(boundary, kd) {
  for (let i = 1; i < boundary.length; i++) { const [a, b] = [boundary[i - 1], boundary[i]]; if (kd >= a.kd && kd <= b.kd) return a.kp + (b.kp - a.kp) * (kd - a.kd) / (b.kd - a.kd || 1); }
  return 0;
}
// The dot while it is held: the scale that it was taken hold of at, and where the finger is beside it.
let turning = null;
const reach = event => event.pointerType === "touch" ? 36 : 20;
function turn(event, last) {
  const r = $("plane").getBoundingClientRect();
  const [damping, stiffness] = view.planeFrame.from(event.clientX - r.left - turning.x, event.clientY - r.top - turning.y);
  // A refusal stands while the finger goes on; what counts is where it lets go.
  if (last) notice("");
  if (!view.again || last === undefined) sendGains({ damping, stiffness }, !last);
}
function besideDot(event) {
  const r = $("plane").getBoundingClientRect(), wall = view.walls[view.wall];
  return { x: event.clientX - r.left - view.planeFrame.X(wall.damping), y: event.clientY - r.top - view.planeFrame.Y(wall.stiffness) };
}
// Gains do not jump to where somebody clicks: only who takes hold of the dot moves it.
$("plane").onpointerdown = event => {
  if (!view.planeFrame || !view.walls[view.wall]) return;
  const { x, y } = besideDot(event);
  if (Math.hypot(x, y) > reach(event)) return;
  $("plane").setPointerCapture(event.pointerId); turning = { tops: view.tops, x, y }; notice("");
};
$("plane").onpointermove = event => {
  if (turning) return turn(event, false);
  if (!view.planeFrame || !view.walls[view.wall]) return;
  const { x, y } = besideDot(event);
  $("plane").style.cursor = Math.hypot(x, y) > reach(event) ? "" : "grab";
};
$("plane").onpointerup = event => { if (turning) turn(event, true); turning = null; };
$("plane").onpointercancel = () => { turning = null; };
$("plane").onkeydown = event => {
  const step = { ArrowUp: ["stiffness", 1.02], ArrowDown: ["stiffness", 1 / 1.02], ArrowRight: ["damping", 1.02], ArrowLeft: ["damping", 1 / 1.02] }[event.key];
  if (step && view.walls[view.wall]) { event.preventDefault(); sendGains({ [step[0]]: view.walls[view.wall][step[0]] * step[1] }); }
};

