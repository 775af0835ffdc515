// ---- the tip's fast motion ----------------------------------------------------------------------------------------
// A buzz of a tenth of a millimetre is less than a pixel, so the tip's deviation from its mean over 27 ms (two periods
// of 73 Hz) is drawn a hundred times as large. A moving hand would be magnified, too: the picture limits it.
const MAGNIFIED = 100, MEAN = .18, MOST = .045;
const calm = matchMedia("(prefers-reduced-motion: reduce)");
function fastMotion() {
  const path = view.recent.flat().map(at => fromTask(at, paddle())), half = Math.max(1, Math.round(MEAN / 2 * path.length)), moves = [];
  for (let i = half; i < path.length - half; i++) {
    const near = path.slice(i - half, i + half), move = [0, 1].map(k => MAGNIFIED * (path[i][k] - near.reduce((sum, at) => sum + at[k], 0) / near.length));
    const long = Math.hypot(...move), most = Math.min(1, MOST / long || 1);
    moves.push([most * move[0], most * move[1]]);
  }
  return moves.slice(-90);
}
function drawMotion(c, f, g) {
  const moves = view.fast && !paper ? fastMotion() : [];
  if (!moves.length) return;
  const tip = tipsOf(g)[paddle()], places = moves.map(([x, y]) => [f.toX(tip[0] + x), f.toY(tip[1] + y)]), tips = g.bars.filter(([, to]) => Math.hypot(to[0] - tip[0], to[1] - tip[1]) < 1e-4);
  const line = list => { c.beginPath(); list.forEach(([x, y], i) => i ? c.lineTo(x, y) : c.moveTo(x, y)); c.stroke(); };
  c.save(); c.strokeStyle = palette.link;
  if (!calm.matches) { c.globalAlpha = .05; for (const place of places.slice(-24)) for (const [from] of tips) line([[f.toX(from[0]), f.toY(from[1])], place]); }
  c.globalAlpha = .35; c.lineWidth = 12; line(places);
  c.restore();
}
// Power (W) above which a wall glows at the tip: a tenth of that of a buzz that can be seen. The glow is full at a
// hundred times as much.
const GLOWS = 4e-4;
function drawGlow(c, f, g) {
  const power = view.last.state === "Armed" ? view.last.numbers.power : 0;
  if (!(power > GLOWS) || paper) return;
  const [x, y] = [f.toX(g.tip[0]), f.toY(g.tip[1])], wide = Math.min(90, f.w / 6), light = c.createRadialGradient(x, y, 6, x, y, wide);
  light.addColorStop(0, palette.bad); light.addColorStop(1, "transparent");
  c.save(); c.globalAlpha = Math.min(1, .25 + .375 * Math.log10(power / GLOWS)); c.fillStyle = light; c.beginPath(); c.arc(x, y, wide, 0, 2 * Math.PI); c.fill(); c.restore();
}

// ---- slow motion --------------------------------------------------------------------------------------------------
// A piece of the newest sweep, twenty times slower, in three steps: the sample of the position, the force that follows
// from it, and the delay between that force and the force that would be due.
const SLOWER = 20, STEP = SWITCH / 3;
let slow = null;
function keepSweep(step) {
  const s = view.sweep, wall = view.walls[view.wall];
  if (!s || s[1] !== 0 || s[2] < .1 || !wall || !view.fast) return;
  const count = s[5], mean = channel => Array.from({ length: count }, (_, i) => (s[6 + 2 * (count * channel + i)] + s[7 + 2 * (count * channel + i)]) / 2);
  const [force, distance] = ["rendered_n", "distance_m"].map(name => mean(view.channels.indexOf(name)));
  if (![...force, ...distance].every(isFinite)) return;
  // Speed over about a millisecond each way. The force that is due acts only inside the wall.
  const dt = s[2] / count, far = Math.max(1, Math.round(1e-3 / dt));
  const due = distance.map((d, i) => d < 0 ? Math.max(0, -wall.stiffness * d - wall.damping * ((distance[i + far] ?? d) - (distance[i - far] ?? d)) / (2 * far * dt)) : 0);
  // The shift at which the two forces differ least, and half a sample for which each force is held on average.
  const differs = shift => { let sum = 0; for (let i = count >> 2; i < 3 * count >> 2; i++) sum += (force[i] - due[i - shift]) ** 2; return sum; };
  const shifts = Array.from({ length: Math.ceil(6e-3 / dt) }, (_, i) => i), best = shifts.reduce((a, b) => differs(b) < differs(a) ? b : a);
  slow = { ...slow, step, force, distance, due, dt, buzz: view.buzz, late: best * dt + .5 / view.hello.rate_hz };
}
const slowRoom = (w, size) => ({ wide: Math.min(22.5 * size, w - 16), high: 9.2 * size, below: w < 50 * size });
function drawSlow(c, w, h, size, f, g) {
  const mode = view.walls[view.wall]?.feed_forward;
  if (paper || !view.fast) { slow = null; return; }
  if (slow?.mode !== mode) slow = { mode, began: performance.now() };
  const shown = (performance.now() - slow.began) / 1000, count = Math.floor(shown / STEP);
  if (slow.step !== count) keepSweep(count);
  if (!slow.force) return;
  const { force, distance, due, dt, late } = slow, step = calm.matches ? 2 : count % 3, at = calm.matches ? (distance.length >> 1) * dt : .03 + (shown % STEP) / SLOWER;
  // In the corner that is farthest from the linkage; in a narrow picture below it (`frame`).
  const { wide, high, below } = slowRoom(w, size), points = [g.tip, ...g.bars.flat()].map(([x, y]) => [f.toX(x), f.toY(y)]);
  const room = ([x, y]) => Math.min(...points.map(([px, py]) => Math.hypot(px - x - wide / 2, py - y - high / 2))), corners = [[w - wide - 8, h - high - 8], [w - wide - 8, 8], [8, h - high - 30]];
  const [x0, y0] = below ? corners[0] : corners.reduce((a, b) => room(b) > room(a) ? b : a);
  c.save(); c.translate(x0, y0); c.fillStyle = palette.card; c.strokeStyle = palette.hatch; c.lineWidth = 1.5;
  c.beginPath(); c.rect(0, 0, wide, high); c.fill(); c.stroke();
  // The tip in the wall, up to its surface; the scale keeps the largest motion so far.
  const middle = distance.reduce((a, b) => a + b) / distance.length, most = Math.max(...distance.map(d => Math.abs(d - middle)), 2e-5);
  view.still = Math.max(view.still || 0, most);
  const y = 4.6 * size, X = d => size * (4 + 2.6 * (d - middle) / view.still), surface = Math.min(wide - size, X(0)), now = Math.min(distance.length - 2, Math.floor(at / dt)), part = at / dt - now;
  c.fillStyle = palette.wall; c.fillRect(1, 1.9 * size, surface, 4.4 * size); c.fillStyle = c.strokeStyle = palette.ink; c.fillText("wall", .4 * size, 3 * size);
  c.beginPath(); c.moveTo(surface, 1.9 * size); c.lineTo(surface, 6.3 * size); c.stroke();
  const tip = X(distance[now] + part * (distance[now + 1] - distance[now])), newton = (wide - 9 * size) / Math.max(...force, 8);
  c.lineWidth = 3;
  if (step > 1) { c.strokeStyle = c.fillStyle = palette.dim; c.setLineDash([4, 4]); arrow(c, tip, y - 1.1 * size, due[now] * newton, 0); c.setLineDash([]); c.fillText("due", tip, y - 1.6 * size); }
  if (step > 0) { c.strokeStyle = c.fillStyle = palette.force; arrow(c, tip, y, force[now] * newton, 0); }
  c.fillStyle = palette.ink; c.beginPath(); c.arc(tip, y, .55 * size, 0, 2 * Math.PI); c.fill();
  c.strokeStyle = palette.ink; c.lineWidth = 1.5; c.beginPath(); c.moveTo(X(distance[now]), y + .8 * size); c.lineTo(X(distance[now]), y + 1.6 * size); c.stroke();
  const ms = seconds => digits(1e3 * seconds, 2) + " ms", words = [
    ["1 Sample: the board reads the tip", `every ${ms(1 / view.hello.rate_hz)} (the mark).`], ["2 Force: computed from that sample,", "held until the next (the arrow)."],
    slow.buzz ? [`3 Delay: the push comes ${ms(late)} late,`, "and drives the tip on."] : !predictedStable() ? ["3 Delay: the push comes late,", "so that a small shake grows."]
      : ["3 Delay: as late as before, but", slow.mode === "off" ? "these gains bear it: it dies out." : "the tip now resists more: it dies out."]][step];
  c.fillStyle = palette.dim; c.fillText("slow motion, 1/20", .5 * size, 1.3 * size);
  c.fillStyle = palette.ink; c.font = `600 ${size}px system-ui, sans-serif`; words.forEach((line, i) => c.fillText(line, .5 * size, (7.3 + 1.3 * i) * size)); c.restore();
}
