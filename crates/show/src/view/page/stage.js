// ---- a simulation runs by itself ----------------------------------------------------------------------------------
// Simulated motors are on without a key, unless a click turned them off (`stopped`). Until the first touch the demo's
// hand presses into the wall and the feed-forward goes off and on, every SWITCH seconds.
const SWITCH = 4;
let touched = false, stopped = false, switched = null, armAfter = 0;
const simulated = () => !!view.hello?.simulated;
function runByItself(p) {
  if (!simulated()) return;
  if (p.state === "Disarmed" && !view.down && !stopped && !document.hidden && performance.now() > armAfter) { armAfter = performance.now() + 500; press(); }
  if (touched || !railed() || p.state !== "Armed") return;
  if (!p.hand) lead(wallPlace(-RAIL.least));
  // Where simulated time lags, a phase ends once its effect has been seen.
  const real = performance.now() / 1000, visible = view.walls[0].feed_forward === "off" ? p.numbers.ripple > 2 * BUZZES : now?.settled;
  if (switched) switched.seen = visible ? switched.seen ?? real : null;
  if (!switched || p.time - switched.time > SWITCH || p.speed < .8 && switched.seen && real - switched.seen > SWITCH / 2) { flip(!switched); switched = { time: p.time }; }
}
function flip(off) { sendGains({ feed_forward: off || view.walls[view.wall]?.feed_forward !== "off" ? "off" : "washout" }); }
$("ff").onclick = () => flip();
// The first touch hands over. A browser allows sound only after a press.
let heard = false;
for (const kind of ["pointerdown", "pointerup", "keydown"]) addEventListener(kind, event => {
  if (event.isTrusted) touched = true; else return;
  if (kind !== "pointerdown" && !heard && simulated()) { heard = true; if (!sound) $("sound").onclick(); }
}, true);

// The demo's hand runs on a rail along the wall's normal, where the device couples: it is in front of the wall, at most
// `before` (m), or as deep as the wall needs for a buzz that grows and the motors can hold.
const RAIL = { before: .012, least: .026, most: .032 };
const railed = () => view.hello?.smooth && $("rail").checked && view.walls[0]?.outline?.is === "line";
function wallPlace(along) { const { at, normal } = view.walls[0].outline; return [at[0] + along * normal[0], at[1] + along * normal[1]]; }
function onRail(place) {
  if (!railed()) return place;
  const { at, normal } = view.walls[0].outline, along = (place[0] - at[0]) * normal[0] + (place[1] - at[1]) * normal[1];
  return wallPlace(along > 0 ? Math.min(along, RAIL.before) : -Math.min(Math.max(-along, RAIL.least), RAIL.most));
}
// While the motors go on, the stage moves the hand.
const paddle = () => Math.min(view.paddle || 0, view.last.geometry.more.length);
function lead(place, last = true) { if (view.down && !view.last.held) return; const message = { do: "hand", at: toTask(onRail(place), paddle(), view.last.hand?.goal || view.trail.at(-1)) }; last ? say(message) : sayThrottled(message); }

// One sentence for the thing that is seen.
function describe(p) {
  const wall = view.walls[p.numbers.wall], off = wall?.feed_forward === "off", stable = predictedStable(), [free, kept] = p.numbers.inertia || [], coupled = kept > 1.005 * free;
  const words = !wall ? "No wall in this scene." : p.state === "Fault" ? "A fault turned the motors off."
    : !view.fast && simulated() && railed() && !touched && !stopped ? "A hand pulls the tip into the wall." : p.state !== "Armed" ? "The motors are off: the wall gives no force."
    : view.limited ? "Not rendered: motors at their limit. Pull less, or choose a softer wall."
    : !view.fast ? simulated() ? "Pull the tip into the wall." : "Move the tip into the wall."
    : view.buzz && stable && !off && !now?.settled ? "The feed-forward is on: the shake dies out."
    : view.buzz ? (kept ? `The force comes late for a tip as light as ${inKilograms(off ? free : kept)}: the wall buzzes.` : "The force comes late: the wall buzzes.") + (off && coupled ? " Turn the feed-forward on." : "")
    : !stable ? `${off ? "Without feed-forward" : "With these gains"} a small shake grows.`
    : !coupled ? "Quiet. Nothing couples here: the feed-forward changes nothing."
    : off ? "Quiet without feed-forward at these gains." : `Quiet: the feed-forward stops the sideways swerve, so the tip resists like ${inKilograms(kept)}, not ${inKilograms(free)}.`;
  tell("told", words);
  $("told").classList.toggle("hot", /the wall buzzes|^Not/.test($("told").textContent));
}
// Changes a live region at most once a second, because a screen reader reads each change.
const toldAt = {};
function tell(id, words) {
  if ($(id).textContent === words || performance.now() - (toldAt[id] || 0) < 1000) return;
  toldAt[id] = performance.now(); $(id).textContent = words;
}

// ---- drawing ------------------------------------------------------------------------------------------------------
const colour = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
let palette = {};
function readPalette() { for (const name of ["card", "ink", "dim", "line", "soft", "wall", "hatch", "link", "hand", "force", "off", "full", "washout", "off-name", "full-name", "washout-name", "spring", "bad", "before"]) palette[name] = colour(name); }
function theme(dark) { document.documentElement.classList.toggle("dark", dark); readPalette(); requestDraw(); }
$("theme").onclick = () => theme(!document.documentElement.classList.contains("dark"));
const prefersDark = matchMedia("(prefers-color-scheme: dark)");
prefersDark.onchange = event => theme(event.matches);
let asked = false, planeToo = false;
function requestDraw(stageOnly) {
  planeToo ||= stageOnly !== true;
  if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; drawStage(); if (planeToo) drawPlane(); planeToo = false; }); }
}
// Also if the window keeps its size: stretching distorts letters, and a single sweep is drawn only once.
const resized = new ResizeObserver(() => { requestDraw(); drawScope(); });
for (const id of ["stage", "plane", "scope"]) resized.observe($(id));
// Returns a cleared canvas, its width, height and letter size in its own pixels; or the picture that is being saved.
let paper = null;
function prepareCanvas(canvas) {
  if (paper) return [paper.context, paper.width, paper.height, paper.size];
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
  const c = canvas.getContext("2d");
  c.setTransform(ratio, 0, 0, ratio, 0, 0); c.clearRect(0, 0, w, h);
  const size = parseFloat(getComputedStyle(document.body).fontSize) * .8;
  c.font = size + "px system-ui, sans-serif"; c.lineJoin = c.lineCap = "round"; c.textBaseline = "alphabetic"; c.textAlign = "left";
  return [c, w, h, size];
}

// ---- the device ---------------------------------------------------------------------------------------------------
// The coordinates of paddles and slides have no plane: each is drawn on its track, an arc or a line.
const tracks = () => view.hello.tracks;
function fromTask(at, track = 0) {
  const t = tracks()[track], s = at[track];
  if (!t) return at;
  if (t.is === "line") return [0, 1].map(k => t.at[k] + s * t.along[k]);
  const angle = t.zero + t.sense * s / t.radius;
  return [t.centre[0] + t.radius * Math.cos(angle), t.centre[1] + t.radius * Math.sin(angle)];
}
// Returns the task position of a drawn place, with the other coordinates of `others`.
function toTask([x, y], track = 0, others = [0, 0]) {
  const t = tracks()[track];
  if (!t) return [x, y];
  const turn = () => { const angle = Math.atan2(y - t.centre[1], x - t.centre[0]) - t.zero; return Math.atan2(Math.sin(angle), Math.cos(angle)); };
  const s = t.is === "line" ? ((x - t.at[0]) * t.along[0] + (y - t.at[1]) * t.along[1]) / (t.along[0] ** 2 + t.along[1] ** 2) : t.sense * t.radius * turn();
  return others.map((other, i) => i === track ? s : other);
}
const tipsOf = g => [g.tip, ...g.more.map(([tip]) => tip)];
// Place of a wall's point.
const wallPoint = wall => fromTask(wall.values, wall.track ?? 0);
function frame(w, h) {
  // During a drag the picture keeps still, because the position under the pointer would move away from it.
  if (grabbed && view.frame?.w === w && view.frame.h === h) return view.frame;
  const g = view.last.geometry;
  // The picture includes the points of walls near the tip.
  const tips = tipsOf(g), isNear = at => tips.some(tip => Math.hypot(at[0] - tip[0], at[1] - tip[1]) < 0.12);
  const near = view.walls.map(wallPoint).filter(isNear);
  const held = g.springs.flatMap(spring => tips.map((_, i) => fromTask(spring, i))).filter(isNear);
  const points = [...tips, ...g.base, ...g.bars.flat(), ...g.rails.flat(), ...near, ...held];
  const box = view.box || [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of points) { box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y); box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y); }
  view.box = box;
  const centre = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
  // Room for the slow motion, and for the legend above the picture.
  const size = parseFloat(getComputedStyle(document.body).fontSize) * .8, slowly = slowRoom(w, size), [top, high] = slowly.below && !paper ? [3 * size, h - slowly.high] : [0, h];
  const scale = Math.min(w / (box[2] - box[0] + 0.09), (high - top) / (box[3] - box[1] + 0.08));
  view.frame = { w, h, scale, toX: x => w / 2 + (x - centre[0]) * scale, toY: y => (top + high) / 2 - (y - centre[1]) * scale,
    from: (px, py) => [centre[0] + (px - w / 2) / scale, centre[1] - (py - (top + high) / 2) / scale] };
  return view.frame;
}
function arrow(c, x, y, dx, dy) {
  const length = Math.hypot(dx, dy); if (length < 3) return;
  const [ux, uy] = [dx / length, dy / length], head = Math.min(12, length * 0.5);
  c.beginPath(); c.moveTo(x, y); c.lineTo(x + dx - ux * head * .7, y + dy - uy * head * .7); c.stroke();
  c.beginPath(); c.moveTo(x + dx, y + dy); c.lineTo(x + dx - ux * head - uy * head * .45, y + dy - uy * head + ux * head * .45);
  c.lineTo(x + dx - ux * head + uy * head * .45, y + dy - uy * head - ux * head * .45); c.closePath(); c.fill();
}
function spring(c, x0, y0, x1, y1) {
  const length = Math.hypot(x1 - x0, y1 - y0); if (length < 2) return;
  const [ux, uy] = [(x1 - x0) / length, (y1 - y0) / length], turns = Math.max(3, Math.min(7, Math.round(length / 8)));
  c.beginPath(); c.moveTo(x0, y0);
  for (let i = 1; i < 2 * turns; i++) { const s = i / (2 * turns) * length, side = (i % 2 ? 5 : -5); c.lineTo(x0 + ux * s - uy * side, y0 + uy * s + ux * side); }
  c.lineTo(x1, y1); c.stroke();
}
// Handle of a wall: for a plane it is next to its point, where the tip is not in the way.
function wallHandle(wall) {
  const v = wall.values, line = wall.outline?.is === "line" ? wall.outline : null, aside = 90 / view.frame.scale;
  if (tracks().length) return wallPoint(wall);
  return line ? [line.at[0] + aside * line.normal[1], line.at[1] - aside * line.normal[0]] : [v[0], v[1]];
}
function drawWall(c, f, w, h, size, wall, index) {
  const v = wall.values, o = wall.outline, chosen = index === view.wall;
  c.save(); c.fillStyle = palette.wall; c.strokeStyle = chosen ? palette.ink : palette.hatch; c.lineWidth = chosen ? 2.5 : 1.5;
  // The wall of one of several paddles ends halfway to the next paddle.
  const pivots = tracks().length > 1 ? tracks().map(t => t.centre || t.at) : [], half = pivots.length ? .5 * f.scale * Math.hypot(pivots[1][0] - pivots[0][0], pivots[1][1] - pivots[0][1]) : 0;
  if (half && o) { c.beginPath(); c.rect(-w, f.toY(pivots[wall.track][1]) - half, 3 * w, 2 * half); c.clip(); }
  if (o?.is === "line") {
    const long = 2 * (w + h);
    c.translate(f.toX(o.at[0]), f.toY(o.at[1])); c.rotate(Math.atan2(o.normal[0], o.normal[1]));
    c.fillRect(-long, 0, 2 * long, long);
    c.beginPath(); c.moveTo(-long, 0); c.lineTo(long, 0); c.stroke();
  } else if (o?.is === "circle") {
    c.beginPath(); c.arc(f.toX(o.at[0]), f.toY(o.at[1]), o.radius * f.scale, 0, 2 * Math.PI); c.stroke();
    if (o.inside) c.rect(-w, -h, 3 * w, 3 * h);
    c.fill("evenodd");
  } else {
    const [x, y] = wallPoint(wall);
    c.fillStyle = palette.ink; c.fillText(wall.shape + ": not drawn in this plane", f.toX(x) + 12, f.toY(y) + 4);
  }
  c.restore();
  if (o) {
    // The wall's name, on the solid side: for a plane next to its point, away from its handle and from the legend; for
    // a hole above it.
    const line = o.is === "line", [nx, ny] = line ? o.normal : [0, 0], up = o.inside ? o.radius * f.scale + 16 : 0;
    const spots = (line ? [100, -170, -45, 45, 220] : [0]).map(aside => [f.toX(o.at[0]) - nx * 30 - ny * aside, f.toY(o.at[1]) + ny * 30 - nx * aside - up]);
    const clear = (x, y) => view.last.geometry.bars.every(([a, b]) => [0, .25, .5, .75, 1].every(t => Math.hypot(f.toX(a[0] + t * (b[0] - a[0])) - x, f.toY(a[1] + t * (b[1] - a[1])) - y) > 3 * size));
    const [X, Y] = spots.find(([x, y]) => clear(x, y) && x > 40 && x < w - 40 && y > 20 && y < h - 40 && (x > 16 * size || y > 7 * size)) || spots[0];
    c.save(); c.font = `700 ${1.25 * size}px system-ui, sans-serif`; c.textAlign = "center"; c.textBaseline = "middle"; c.lineWidth = 4;
    c.strokeStyle = palette.card; c.fillStyle = palette.ink; c.strokeText("WALL", X, Y); c.fillText("WALL", X, Y); c.restore();
  }
  if (paper || !document.body.classList.contains("more")) return;
  const [x, y] = wallHandle(wall);
  c.fillStyle = palette.card; c.strokeStyle = palette.hatch; c.lineWidth = 2;
  c.beginPath(); c.arc(f.toX(x), f.toY(y), 7, 0, 2 * Math.PI); c.fill(); c.stroke();
  if (o?.is === "line" && !tracks().length) {
    c.fillStyle = c.strokeStyle = palette.hatch; arrow(c, f.toX(x), f.toY(y) , o.normal[0] * 38, -o.normal[1] * 38);
  }
}
// A spring pulls the tip to its point, or to the nearest point of its line.
function drawSprings(c, f, w, h, g) {
  c.strokeStyle = c.fillStyle = palette.spring;
  g.springs.forEach((held, index) => {
    const s = view.springs[index]; if (!s) return;
    tipsOf(g).forEach((tip, i) => {
      const at = fromTask(held, i), [x, y] = [f.toX(at[0]), f.toY(at[1])], [dx, dy] = s.direction, long = 2 * (w + h);
      if (!tracks().length && Math.hypot(dx, dy) > 0) {
        c.lineWidth = 2; c.setLineDash([8, 5]); c.beginPath(); c.moveTo(x - long * dx, y + long * dy); c.lineTo(x + long * dx, y - long * dy); c.stroke(); c.setLineDash([]);
      }
      c.lineWidth = 2; spring(c, x, y, f.toX(tip[0]), f.toY(tip[1]));
      c.fillRect(x - 4, y - 4, 8, 8);
    });
  });
}
function drawStage() {
  if (!view.last || !view.hello) return;
  const [c, w, h, size] = prepareCanvas($("stage")), g = view.last.geometry, f = frame(w, h);
  view.walls.forEach((wall, index) => drawWall(c, f, w, h, size, wall, index));
  drawGlow(c, f, g);
  drawSprings(c, f, w, h, g);
  const expert = document.body.classList.contains("more");
  c.strokeStyle = palette.dim; c.lineWidth = 1.5; c.beginPath();
  if (expert) g.more.length || view.trail.map(at => fromTask(at)).forEach(([x, y], i) => i ? c.lineTo(f.toX(x), f.toY(y)) : c.moveTo(f.toX(x), f.toY(y))); c.stroke();
  const ellipse = expert && g.ellipse && view.hello.flat;
  if (ellipse) {
    // A kilogram is drawn as 12 cm.
    const grow = 0.12 * f.scale;
    c.strokeStyle = palette.ink; c.lineWidth = 1.5; c.setLineDash([5, 3]); c.beginPath();
    c.ellipse(f.toX(g.tip[0]), f.toY(g.tip[1]), g.ellipse.axes[0] * grow, Math.max(0, g.ellipse.axes[1]) * grow, -g.ellipse.angle, 0, 2 * Math.PI); c.stroke(); c.setLineDash([]);
  }
  c.strokeStyle = palette.link; c.lineWidth = Math.max(4, Math.min(10, .006 * f.scale)); c.globalAlpha = .85;
  drawMotion(c, f, g);
  c.save(); c.strokeStyle = palette.hatch; c.lineWidth = 3;
  for (const [from, to] of g.rails) { c.beginPath(); c.moveTo(f.toX(from[0]), f.toY(from[1])); c.lineTo(f.toX(to[0]), f.toY(to[1])); c.stroke(); }
  c.restore();
  for (const [from, to] of g.bars) { c.beginPath(); c.moveTo(f.toX(from[0]), f.toY(from[1])); c.lineTo(f.toX(to[0]), f.toY(to[1])); c.stroke(); }
  c.globalAlpha = 1; c.lineWidth = 2;
  for (const [x, y] of [...g.base, ...g.bars.map(bar => bar[1])]) { c.fillStyle = palette.card; c.beginPath(); c.arc(f.toX(x), f.toY(y), 5, 0, 2 * Math.PI); c.fill(); c.stroke(); }
  const hand = view.last.hand, tips = tipsOf(g);
  if (railed()) { c.strokeStyle = palette.hand; c.lineWidth = 1; c.beginPath(); for (const along of [RAIL.before, -RAIL.most]) { const [rx, ry] = wallPlace(along); c.lineTo(f.toX(rx), f.toY(ry)); } c.stroke(); }
  if (hand) {
    c.strokeStyle = palette.hand; c.fillStyle = palette.hand; c.lineWidth = 2;
    for (let i = 0; i < Math.min(2, tips.length); i++) {
      const [goal, at] = [fromTask(hand.goal, i), fromTask(hand.at, i)];
      spring(c, f.toX(goal[0]), f.toY(goal[1]), f.toX(at[0]), f.toY(at[1]));
      c.beginPath(); c.arc(f.toX(goal[0]), f.toY(goal[1]), 6, 0, 2 * Math.PI); c.fill();
      c.globalAlpha = .35; c.beginPath(); c.arc(f.toX(at[0]), f.toY(at[1]), 13, 0, 2 * Math.PI); c.fill(); c.globalAlpha = 1;
    }
  }
  for (const [tip, force] of [[g.tip, g.force], ...g.more]) {
    const [x, y] = [f.toX(tip[0]), f.toY(tip[1])];
    c.fillStyle = palette.ink; c.beginPath(); c.arc(x, y, 6, 0, 2 * Math.PI); c.fill();
    c.strokeStyle = c.fillStyle = palette.force; c.lineWidth = 3;
    // A newton is drawn as 12 pixels, at most a third of the picture.
    const newton = 12 * Math.min(1, Math.min(w, h) / 36 / Math.hypot(...force));
    arrow(c, x, y, force[0] * newton, -force[1] * newton);
  }
  drawSlow(c, w, h, size, f, g);
  // Scale and legend.
  const length = .05 * f.scale;
  c.strokeStyle = c.fillStyle = palette.dim; c.lineWidth = 2; c.beginPath(); c.moveTo(12, h - 12); c.lineTo(12 + length, h - 12); c.stroke();
  c.fillText("50 mm", 12, h - 18);
  let top = 16;
  const legend = [["force", "force of the motors"], ["link", view.fast ? "motion of the tip, ×100" : ""], ["hand", hand ? "hand, " + unit(Math.hypot(...hand.force), "N") : ""], ["ink", ellipse ? "effective inertia" : ""],
    ["spring", view.springs.length ? "spring, " + view.springs.map(s => unit(s.stiffness, "N/m")).join(", ") : ""], ["dim", view.field > 0 ? "damping everywhere, " + unit(view.field, "N s/m") : ""]].filter(([, words]) => words);
  const high = 1.35 * size;
  c.fillStyle = palette.card; c.globalAlpha = .8; c.fillRect(2, 2, Math.max(...legend.map(([, words]) => c.measureText("● " + words).width)) + 12, legend.length * high + 6); c.globalAlpha = 1;
  for (const [name, words] of legend) {
    c.fillStyle = palette[name]; c.fillText("●", 8, top);
    c.fillStyle = palette.ink; c.fillText(words, 8 + c.measureText("● ").width, top); top += high;
  }
}
let lastSent = 0, grabbed = null;
function sayThrottled(message) { const now = performance.now(); if (now - lastSent > 15) { lastSent = now; say(message); } }
const placeOf = event => { const r = $("stage").getBoundingClientRect(); return [event.clientX - r.left, event.clientY - r.top]; };
$("stage").onpointerdown = event => {
  if (!view.frame) return;
  const [px, py] = placeOf(event), f = view.frame;
  const near = (x, y) => Math.hypot(f.toX(x) - px, f.toY(y) - py) < 13;
  $("stage").setPointerCapture(event.pointerId);
  grabbed = { hand: true };
  // Only a handle that is drawn moves its wall, and a tip takes precedence over it. The hand takes the nearest paddle.
  const tips = tipsOf(view.last.geometry), far = tips.map(([x, y]) => Math.hypot(f.toX(x) - px, f.toY(y) - py));
  view.paddle = far.indexOf(Math.min(...far));
  if (document.body.classList.contains("more") && !(view.hello.simulated && tips.some(tip => near(...tip)))) view.walls.forEach((wall, index) => {
    const [x, y] = wallHandle(wall), v = wall.values, [nx, ny] = wall.outline?.normal || [];
    if (near(x, y)) grabbed = { wall: index, point: [v[0], v[1]], track: wall.track ?? 0, aside: tracks().length ? [0, 0] : [x - v[0], y - v[1]] };
    else if (nx !== undefined && !tracks().length && Math.hypot(f.toX(x) + nx * 38 - px, f.toY(y) - ny * 38 - py) < 13) grabbed = { wall: index, point: [v[0], v[1]], from: [x, y] };
  });
  if (grabbed.wall !== undefined) { view.wall = grabbed.wall; showGains(); } else if (!view.hello.simulated) grabbed = null;
  moved(event);
};
function moved(event, last) {
  if (!grabbed) return;
  const at = view.frame.from(...placeOf(event));
  if (grabbed.hand) return lead(at, last);
  const message = { do: "wall", wall: grabbed.wall, point: grabbed.from ? grabbed.point : toTask([at[0] - grabbed.aside[0], at[1] - grabbed.aside[1]], grabbed.track, grabbed.point) };
  if (grabbed.from) message.normal = [at[0] - grabbed.from[0], at[1] - grabbed.from[1]];
  last ? say(message) : sayThrottled(message);
}
$("stage").onpointermove = event => moved(event);
$("stage").onpointerup = event => { moved(event, true); grabbed = null; };
$("stage").onpointercancel = () => { grabbed = null; };
// Two millimetres a press; on the rail, out of the wall at once.
$("stage").onkeydown = event => {
  const step = { ArrowUp: [0, 2e-3], ArrowDown: [0, -2e-3], ArrowRight: [2e-3, 0], ArrowLeft: [-2e-3, 0] }[event.key];
  if (!step || !view.last || !view.hello?.simulated) return;
  event.preventDefault();
  const at = view.last.hand ? fromTask(view.last.hand.goal, paddle()) : tipsOf(view.last.geometry)[paddle()], out = railed() && step[0] * view.walls[0].outline.normal[0] + step[1] * view.walls[0].outline.normal[1] > 0;
  lead(out ? wallPlace(RAIL.before) : [at[0] + step[0], at[1] + step[1]]);
};
// A new start runs by itself again.
$("start-over").onclick = $("anew").onclick = () => {
  up(); notice(""); $("beyond").checked = touched = stopped = false; switched = null; armAfter = 0;
  if (view.hello.rate_hz !== view.firstRate) say({ do: "rate", hz: view.firstRate });
  say({ do: "start-over" }); resetComparison();
};
$("let-go").onclick = () => say({ do: "hand", at: null });

