// ---- stiffness and damping ----------------------------------------------------------------------------------------
const MODES = ["off", "full", "washout"], NAMES = { off: "off", full: "full", washout: "washed out" };
// The switch calls the washed-out feed-forward on.
const nameOf = mode => mode === "washout" && !paper && !document.body.classList.contains("more") ? "on" : NAMES[mode];
// While a gain is being typed, the input keeps its text until the gain is refused.
function showGains(force) {
  const count = view.walls.length;
  if ($("wall").options.length !== count) $("wall").replaceChildren(...view.walls.map((_, i) => new Option("wall " + i, i)));
  $("wall").hidden = count < 2;
  view.wall = Math.min(view.wall, Math.max(0, count - 1)); $("wall").value = view.wall;
  const wall = view.walls[view.wall]; if (!wall) return;
  for (const id of ["stiffness", "damping"]) if (force || document.activeElement !== $(id)) $(id).value = +wall[id].toPrecision(4);
  const [off, on] = $("ff").children, is = wall.feed_forward;
  $("ff").setAttribute("aria-checked", is !== "off"); off.className = is === "off" ? "off" : ""; on.className = is === "off" ? "" : is; on.textContent = is === "full" ? "full" : "on";
  for (const mode of MODES) { const on = wall.feed_forward === mode; $("ff-" + mode).classList.toggle("on", on); $("ff-" + mode).setAttribute("aria-pressed", on); }
  requestDraw();
}
function sendGains(change, throttled) {
  const { stiffness, damping, feed_forward } = { ...view.walls[view.wall], ...change };
  const message = { do: "gains", wall: view.wall, stiffness, damping, feed_forward, beyond: simulated() || $("beyond").checked };
  throttled ? sayThrottled(message) : say(message);
}
for (const mode of MODES) $("ff-" + mode).onclick = () => sendGains({ feed_forward: mode });
for (const id of ["stiffness", "damping"]) $(id).onchange = () => {
  const value = $(id).valueAsNumber;
  if (value >= 0) sendGains({ [id]: value }); else { notice(`${id} is a number from 0`, { of: "gains" }); showGains(true); }
};
$("wall").onchange = () => { view.wall = +$("wall").value; showGains(); };
$("scale").onchange = () => requestDraw();

// ---- the axes -----------------------------------------------------------------------------------------------------
// Returns the next number at or above the value that is 1, 2 or 5 times a power of ten.
function roundUp(value, steps = [1, 2, 5, 10]) { const power = 10 ** Math.floor(Math.log10(value) + 1e-9); return steps.map(n => n * power).find(n => n >= value * (1 - 1e-9)); }
const nice = most => roundUp(most / 6.5), tick = value => String(+value.toPrecision(4));
// Creates an axis from `start` to `end`, in pixels. A logarithmic axis begins above zero; zero then lies far before its
// start.
function axisOf([low, high], start, end, log, most) {
  const part = log ? v => Math.max(-9, Math.log(v / low) / Math.log(high / low)) : v => v / high, ticks = [];
  if (!log) for (let i = 0, step = roundUp(high / most); i * step <= high; i++) ticks.push(i * step);
  else {
    const marks = [[1, 2, 5], [1, 3], [1]].find(marks => Math.log10(high / low) * marks.length <= most) || [1];
    for (let power = 10 ** Math.floor(Math.log10(low)); power <= high; power *= 10) ticks.push(...marks.map(n => n * power).filter(v => v >= low && v <= high));
  }
  return { to: v => start + part(v) * (end - start), ticks,
    from: px => { const at = Math.max(0, (px - start) / (end - start)); return log ? low * (high / low) ** at : at * high; } };
}
// Returns the ends of an axis, for all curves or for the range near the dot. The ends are round numbers, so that the
// picture keeps still while the dot is moved.
function ends(gain, top, scale) {
  const all = Math.max(top, gain * 1.3) || 1;
  if (scale === "near") return [0, Math.min(all, roundUp(1.3 * (gain || all / 100), [1, 1.5, 2, 3, 4, 5, 6, 8, 10]))];
  return [scale === "log" ? roundUp(Math.max(Math.min(gain || all / 100, all / 10) / 5, all / 1e5)) : 0, all];
}
// Chooses logarithmic axes if the dot would be in the corner of linear axes.
let scaledFor = null;
function chooseScale(wall, kdTop, kpTop) {
  if (scaledFor === view.hello) return;
  scaledFor = view.hello;
  $("scale").value = view.scale ? view.scale : wall.damping > kdTop / 12 && wall.stiffness > kpTop / 12 ? "even" : "log";
}
function below(boundary, kd) {
  for (let i = 1; i < boundary.length; i++) { const [a, b] = [boundary[i - 1], boundary[i]]; if (kd >= a.kd && kd <= b.kd) return a.kp + (b.kp - a.kp) * (kd - a.kd) / (b.kd - a.kd || 1); }
  return 0;
}

// ---- the picture --------------------------------------------------------------------------------------------------
// Places words where they cover least: `places` are the possible positions, the best first; `points` are the points of
// the curves.
function place(c, size, words, places, taken, points, [left, top, right, foot]) {
  const high = 1.3 * size, wide = Math.max(...words.map(line => c.measureText(line).width)) + 4, tall = high * words.length;
  let best = null;
  places.forEach(([x, y, sideX, sideY], order) => {
    const box = [Math.min(right - wide, Math.max(left + 2, x - (sideX < 0 ? wide : sideX ? 0 : wide / 2))), Math.min(foot - tall - 2, Math.max(top + 1, y - (sideY < 0 ? tall : 0)))];
    const meets = ([bx, by, bw, bh]) => box[0] < bx + bw && box[0] + wide > bx && box[1] < by + bh && box[1] + tall > by;
    const cost = 1000 * taken.filter(meets).length + 8 * points.filter(([px, py]) => meets([px - 1, py - 1, 2, 2])).length + order;
    if (!best || cost < best.cost) best = { cost, box };
  });
  if (!best) return;
  taken.push([...best.box, wide, tall]);
  c.save(); c.textAlign = "left"; c.lineWidth = 4; c.strokeStyle = palette.card;
  words.forEach((line, i) => { const [x, y] = [best.box[0] + 2, best.box[1] + high * (i + .8)]; c.strokeText(line, x, y); c.fillText(line, x, y); });
  c.restore();
}
const planeOf = index => view.plane?.wall === index ? view.plane : null;
function predictedStable() {
  const wall = view.walls[view.wall], plane = planeOf(view.wall);
  return !view.limited && (!plane || !wall || wall.stiffness <= below(plane[wall.feed_forward], wall.damping));
}
let spoken = null;
function drawPlane() {
  const [c, w, h, size] = prepareCanvas($("plane")), wall = view.walls[view.wall];
  view.predictedBuzz = null;
  if (!wall) { c.fillStyle = palette.dim; c.fillText("no wall in this scene", 12, 24); return; }
  // Full is drawn for experts, and where it is chosen.
  const plane = planeOf(view.wall), drawn = MODES.filter(mode => mode !== "full" || paper || wall.feed_forward === mode || document.body.classList.contains("more"));
  const most = gain => plane ? Math.max(...MODES.flatMap(mode => plane[mode].map(p => p[gain]))) : 0, tops = [1.08 * most("kd"), 1.12 * most("kp")];
  if (plane) chooseScale(wall, ...tops);
  const scale = $("scale").value, log = scale === "log";
  let [kdEnds, kpEnds] = [ends(wall.damping, tops[0], scale), ends(wall.stiffness, tops[1], scale)];
  // The picture keeps its scale during a drag, and where a limit of the motors lets the tip slide to another pose.
  if (turning || view.limited && view.ends) [kdEnds, kpEnds] = turning?.ends || view.ends; else view.ends = [kdEnds, kpEnds];
  const left = 4.2 * size, right = w - 10, top = 8, foot = h - 2.7 * size, kilo = kpEnds[1] > 2000;
  const ax = axisOf(kdEnds, left, right, log, (right - left) / (4.6 * size)), ay = axisOf(kpEnds, foot, top, log, (foot - top) / (2.2 * size));
  const X = kd => Math.max(left, ax.to(kd)), Y = kp => Math.min(foot, ay.to(kp));
  view.planeFrame = { X, Y, from: (px, py) => [ax.from(px), ay.from(py)] };
  c.fillStyle = palette.dim; c.strokeStyle = palette.line; c.lineWidth = 1; c.textAlign = "center";
  const rule = (...ends) => { c.beginPath(); c.moveTo(ends[0], ends[1]); c.lineTo(ends[2], ends[3]); c.stroke(); };
  for (const kd of ax.ticks) { rule(X(kd), top, X(kd), foot); c.fillText(tick(kd), X(kd), foot + 1.2 * size); }
  c.textAlign = "right";
  for (const kp of ay.ticks) { rule(left, Y(kp), right, Y(kp)); c.fillText(tick(kilo ? kp / 1000 : kp), left - 6, Y(kp) + .35 * size); }
  c.fillText("damping, N s/m", right, foot + 2.4 * size);
  c.save(); c.translate(size, top + 4); c.rotate(-Math.PI / 2); c.fillText(`stiffness, ${kilo ? "kN/m" : "N/m"}`, 0, 0); c.restore();
  c.textAlign = "left";
  // The curves, and the visible points of each.
  const points = {}, room = [left, top, right, foot];
  c.save(); c.beginPath(); c.rect(left, top, right - left, foot - top); c.clip();
  if (plane) for (const mode of drawn) {
    const mine = wall.feed_forward === mode, [first, second] = plane[mode], curve = [...plane[mode]];
    // Adds points to the first piece, which is straight and thus curved on logarithmic axes.
    if (second) for (let share = .5; share > 1e-3; share /= 2) curve.splice(1, 0, { kd: second.kd * share, kp: first.kp + (second.kp - first.kp) * share });
    const path = curve.map(p => [ax.to(p.kd), Math.min(ay.to(p.kp), foot + 9)]);
    c.strokeStyle = c.fillStyle = palette[mode]; c.lineWidth = mine ? 3 : 1.6; c.setLineDash(DASH[mode].map(long => long * c.lineWidth / 1.5));
    c.beginPath(); path.forEach(([x, y], i) => i ? c.lineTo(x, y) : c.moveTo(x, y)); c.stroke(); c.setLineDash([]);
    if (mine) { c.lineTo(path.at(-1)?.[0], foot); c.lineTo(path[0]?.[0], foot); c.closePath(); c.globalAlpha = .13; c.fill(); c.globalAlpha = 1; }
    points[mode] = path.filter(([x, y]) => x >= left && x <= right && y >= top && y < foot - 1);
  } else { c.fillStyle = palette.dim; c.fillText("the boundary is computed when the tip is nearest to this wall", left + 8, top + 1.4 * size); }
  points.marks = drawMarks(c, X, Y, plane, wall);
  c.restore();
  const limit = plane ? below(plane[wall.feed_forward], wall.damping) : null, stable = predictedStable();
  document.body.dataset.stable = stable;
  if (!stable && view.last?.numbers.wall === view.wall) view.predictedBuzz = view.last.buzz?.hz ?? null;
  const [x, y] = [X(wall.damping), Y(wall.stiffness)], gains = `${unit(wall.stiffness, "N/m")}, ${unit(wall.damping, "N s/m")}`;
  const verdict = view.limited ? "not rendered: motors at their limit" : stable ? limit === null ? "" : "predicted stable" : "predicted " + (view.predictedBuzz ? `buzz at ${digits(view.predictedBuzz, 2)} Hz` : "to be unstable");
  c.fillStyle = stable ? palette.ink : palette.bad; c.strokeStyle = palette.card; c.lineWidth = 3;
  c.beginPath(); c.arc(x, y, 9, 0, 2 * Math.PI); c.fill(); c.stroke();
  const taken = [[x - 11, y - 11, 22, 22]], sides = [[1, 1], [1, -1], [-1, 1], [-1, -1]].map(([sx, sy]) => [x + 13 * sx, y + 5 * sy, sx, sy]);
  // The mark of the present gains is under the dot.
  const here = tried.marks.find(mark => mark.key === keyOf(view.wall, wall) && plane && isHere(mark, plane.q));
  place(c, size, [gains, verdict, here && "tried: " + (here.buzzes ? "it buzzes" : stable ? "quiet" : "quiet (friction, a hand)")].filter(line => line), sides, taken, Object.values(points).flat(), room);
  // If curves coincide, as for a paddle, they share one label.
  const same = (a, b) => plane[a].every((p, i) => Math.abs(p.kp - plane[b][i]?.kp) <= .003 * tops[1] && Math.abs(p.kd - plane[b][i].kd) <= .003 * tops[0]);
  for (const mode of MODES) if (points[mode]?.length) {
    const alike = MODES.filter(other => points[other] && same(mode, other)), mine = alike.includes(wall.feed_forward);
    if (mode !== (mine ? wall.feed_forward : alike[0])) continue;
    const own = points[mode], peak = own.reduce((best, p, i) => p[1] < own[best][1] ? i : best, 0);
    const near = own.map((_, i) => i).filter(i => i % Math.ceil(own.length / 40) === 0 || i === peak).sort((a, b) => Math.abs(a - peak) - Math.abs(b - peak));
    c.fillStyle = palette[mode + "-name"]; c.font = `${mine ? 700 : 400} ${size}px system-ui, sans-serif`;
    place(c, size, [alike.map(nameOf).join(", ")], near.flatMap(i => { const [x, y] = own[i]; return [[x, y, 0, -1], [x + 4, y, 1, -1], [x - 4, y, -1, 1], [x, y, 0, 1]]; }), taken, Object.values(points).flat(), room);
  }
  // Announces a change of gains, but not a change of the limit that comes from a moving hand.
  const state = `${gains}, feed-forward ${nameOf(wall.feed_forward)}${verdict && ": " + verdict}${here ? here.buzzes ? ", tried: it buzzes" : ", tried: quiet" : ""}`;
  if (spoken !== state) { spoken = state; $("dot").textContent = state + (limit === null ? "" : `; limit ${unit(limit, "N/m")} at this damping`); }
  showLimits(plane, wall);
}

// ---- the dot ------------------------------------------------------------------------------------------------------
// During a drag of the dot: the axes at its start, and the pointer's offset from the dot.
let turning = null;
const reach = event => event.pointerType === "touch" ? 36 : 20;
function turn(event, last) {
  const r = $("plane").getBoundingClientRect();
  const [damping, stiffness] = view.planeFrame.from(event.clientX - r.left - turning.x, event.clientY - r.top - turning.y);
  // Keeps a refusal during the drag; only the gains at its end count.
  if (last && view.of === "gains") notice("");
  if (!view.again || last === undefined) sendGains({ damping, stiffness }, !last);
}
function offsetFromDot(event) {
  const r = $("plane").getBoundingClientRect(), wall = view.walls[view.wall];
  return { x: event.clientX - r.left - view.planeFrame.X(wall.damping), y: event.clientY - r.top - view.planeFrame.Y(wall.stiffness) };
}
// Gains do not jump to a click: only dragging the dot moves it.
$("plane").onpointerdown = event => {
  if (!view.planeFrame || !view.walls[view.wall]) return;
  const { x, y } = offsetFromDot(event);
  if (Math.hypot(x, y) > reach(event)) return;
  $("plane").setPointerCapture(event.pointerId); turning = { ends: view.ends, x, y }; if (view.of === "gains") notice("");
};
$("plane").onpointermove = event => {
  if (turning) return turn(event, false);
  if (!view.planeFrame || !view.walls[view.wall]) return;
  const { x, y } = offsetFromDot(event);
  $("plane").style.cursor = Math.hypot(x, y) > reach(event) ? "" : "grab";
};
$("plane").onpointerup = event => { if (turning) turn(event, true); turning = null; };
$("plane").onpointercancel = () => { turning = null; };
// Each press moves the dot by two percent, with Shift by ten; from zero by a thousandth of the visible range.
$("plane").onkeydown = event => {
  const [gain, end, up] = { ArrowUp: ["stiffness", 1, true], ArrowDown: ["stiffness", 1], ArrowRight: ["damping", 0, true], ArrowLeft: ["damping", 0] }[event.key] || [];
  const wall = view.walls[view.wall], step = event.shiftKey ? 1.1 : 1.02;
  if (!gain || !wall || !view.ends) return;
  event.preventDefault();
  sendGains({ [gain]: up ? wall[gain] * step || view.ends[end][1] / 1000 : wall[gain] / step });
};

