// ---- tried gains --------------------------------------------------------------------------------------------------
// A press on the wall marks its gains: with a disc if the wall was quiet, with a cross if its force rippled more than
// BUZZES. A long press is judged by its last 0.2 s, and the tip may lift off in between. Where a shake is predicted to
// grow, only a longer press is quiet.
const PRESSED = .3, GROWN = 2, LATELY = .2, LIFTED = .15;
let tried = { marks: [] };
const keyOf = (index, wall) => [index, wall.stiffness, wall.damping, wall.feed_forward].join();
function markGains(p) {
  const n = p.numbers, wall = view.walls[n.wall], at = wall && JSON.stringify(wall.values);
  if (tried.of !== view.hello) tried = { of: view.hello, marks: [], places: {} };
  if (!wall || p.state !== "Armed") { tried.press = null; return; }
  if (tried.places[n.wall] !== at) { tried.places[n.wall] = at; tried.marks = tried.marks.filter(mark => mark.wall !== n.wall); }
  const key = keyOf(n.wall, wall);
  if (tried.press && (tried.press.key !== key || p.time - tried.press.last > LIFTED)) tried.press = null;
  // Ignores a press at the motors' limit, because there no wall is felt.
  if (n.saturated > LIMITED) tried.press = null;
  if (!(n.depth > 0) || n.saturated > LIMITED) return;
  const press = tried.press ||= { key, began: p.time, ripples: [] };
  press.last = p.time;
  press.ripples = [...press.ripples.filter(([time]) => p.time - time <= LATELY), [p.time, n.ripple]];
  if (p.time - press.began < PRESSED) return;
  const buzzes = Math.min(...press.ripples.map(([, ripple]) => ripple)) > BUZZES;
  if (!buzzes && !predictedStable() && p.time - press.began < GROWN) return;
  const mark = { key, wall: n.wall, kp: wall.stiffness, kd: wall.damping, mode: wall.feed_forward, buzzes, q: p.q };
  tried.marks = [...tried.marks.filter(old => old !== press.mark && (old.key !== key || !isHere(old, p.q))), mark].slice(-200);
  press.mark = mark;
}
// A mark belongs to the pose of its press: it counts for a boundary predicted within 0.04 rad of that pose.
const isHere = (mark, q) => q.every((angle, i) => Math.abs(angle - mark.q[i]) < .04);
function drawMarks(c, X, Y, plane, wall) {
  $("forget").hidden = !tried.marks.length;
  const drawn = [];
  for (const { wall: index, kp, kd, mode, buzzes, ...mark } of tried.marks) {
    if (index !== view.wall) continue;
    const [x, y, r] = [X(kd), Y(kp), mode === wall.feed_forward ? 4.5 : 3];
    c.globalAlpha = plane && isHere(mark, plane.q) ? 1 : .3; c.fillStyle = c.strokeStyle = palette[mode]; c.lineWidth = 2;
    c.beginPath();
    drawn.push([x, y]);
    if (buzzes) { c.moveTo(x - r, y - r); c.lineTo(x + r, y + r); c.moveTo(x - r, y + r); c.lineTo(x + r, y - r); c.stroke(); } else { c.arc(x, y, r, 0, 2 * Math.PI); c.fill(); }
  }
  c.globalAlpha = 1;
  return drawn;
}
$("forget").onclick = () => { tried.marks = []; requestDraw(); };

// ---- limiting effects and assumptions -----------------------------------------------------------------------------
let limits = { requested: 0 };
function element(name, ...content) { const made = document.createElement(name); made.append(...content); return made; }
function showLimits(plane, wall) {
  if ($("limits").hidden) return;
  const known = plane?.limits?.feed_forward === wall.feed_forward ? plane.limits : null, now = performance.now();
  // Another pose or feed-forward needs a new request, but not during a movement.
  if (plane && !known && now - limits.requested > 1000) { limits.requested = now; say({ do: "explain" }); }
  const here = plane ? tried.marks.filter(mark => mark.wall === view.wall && mark.mode === wall.feed_forward && isHere(mark, plane.q) && Math.abs(mark.kd - wall.damping) <= .1 * wall.damping) : [];
  const state = JSON.stringify([plane?.q, known, view.last?.held, wall, here.map(mark => [mark.kp, mark.buzzes])]);
  if (limits.state === state) return;
  limits.state = state;
  if (!plane) return $("limits").replaceChildren(element("p", "No prediction here: the tip is nearer to another wall, or the pose is singular, or the loop has no linear form."));
  const parts = [element("h3", `What limits “${NAMES[wall.feed_forward]}”`)];
  if (!known) parts.push(element("p", window.playground && view.last?.held ? "Computed when the motors are off." : "…"));
  else {
    const all = known.stiffness, rows = known.without.map(({ effect, instead, stiffness }) => [`${effect}: ${instead}`, stiffness, all && stiffness !== null ? stiffness / all : Infinity]);
    parts.push(element("p", all === null ? "No stiffness is predicted to be unstable." : `Stiffest stable wall: ${unit(all, "N/m")}, at ${unit(known.damping, "N s/m")}. With one thing changed:`));
    parts.push(element("table", ...rows.sort((a, b) => b[2] - a[2]).map(([words, stiffness, times]) => element("tr", element("td", words), element("td", stiffness === null ? "no limit" : unit(stiffness, "N/m")), element("td", isFinite(times) ? digits(times) + " ×" : "")))));
    parts.push(element("p", `Encoder: a count moves the tip by ${unit(known.count, "m")} and changes the force by ${unit(known.count * wall.stiffness, "N")}.`));
  }
  const [quiet, loud] = [false, true].map(buzzes => here.filter(mark => mark.buzzes === buzzes).map(mark => mark.kp));
  if (here.length) parts.push(element("p", `Tried at about this damping: ${[quiet.length && `quiet at ${unit(Math.max(...quiet), "N/m")}`, loud.length && `buzzed at ${unit(Math.min(...loud), "N/m")}`].filter(words => words).join(", ")}; predicted limit ${unit(below(plane[wall.feed_forward], wall.damping), "N/m")}.`));
  parts.push(element("h3", "Assumptions"), element("ul", ...plane.assumes.map(words => element("li", words))));
  $("limits").replaceChildren(...parts);
}
function openLimits(open) { $("limits").hidden = !open; $("explain").setAttribute("aria-expanded", open); $("explain").classList.toggle("on", open); limits = { requested: 0 }; requestDraw(); }
$("explain").onclick = () => openLimits($("limits").hidden);
$("limits").onkeydown = event => { if (event.key === "Escape") { openLimits(false); $("explain").focus(); } };

