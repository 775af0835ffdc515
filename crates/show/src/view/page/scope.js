// ---- scope --------------------------------------------------------------------------------------------------------
// Telemetry signals by the first word of their label: displayed name, unit of the axis, and factor from SI to that
// unit.
const SIGNALS = {
  rendered: ["wall force", "N", 1], force: ["requested wall force", "N", 1], distance: ["distance to the wall", "mm", 1e3], velocity: ["speed along the normal", "mm/s", 1e3],
  energy: ["energy taken up", "mJ", 1e3], tip_x: ["tip x", "mm", 1e3], tip_y: ["tip y", "mm", 1e3], tip_z: ["tip z", "mm", 1e3], tip: ["tip", "mm", 1e3],
  q: ["angle", "°", 180 / Math.PI], torque: ["torque", "mN m", 1e3], saturated: ["limited", "", 1], counts: ["encoder", "counts", 1], state: ["state", "", 1], contacts: ["walls touched", "", 1],
};
function signal(label) {
  const [, word, joint] = /^(tip_[xyz]|[a-z]+)(\d*)/.exec(label), [name, unit, factor] = SIGNALS[word] || [label, "", 1];
  return { name: name + (joint ? ", joint " + joint : ""), unit, factor };
}
$("window").replaceChildren(...[.005, .01, .02, .05, .1, .2, .5, 1, 2].map(s => new Option(s < 1 ? s * 1000 + " ms" : s + " s", s)));
$("window").selectedIndex = 5;
// Lists the signals that a device has, and restores the previous choice.
function setSignals(columns) {
  for (const [id, chosen] of [["channel-a", "rendered_n"], ["channel-b", ""]]) {
    const kept = $(id).value || chosen;
    $(id).replaceChildren(...(id === "channel-b" ? [new Option("none", "")] : []), ...columns.map(label => new Option(signal(label).name, label)));
    $(id).value = kept && !columns.includes(kept) ? columns[0] : kept;
  }
  fit();
}
function askScope() {
  if (!view.hello) return;
  const channels = [$("channel-a").value, $("channel-b").value].filter(name => name), kind = $("trigger").value;
  const request = { do: "scope", channels, seconds: +$("window").value };
  if (kind) request.trigger = { channel: channels[0], level: ($("level").valueAsNumber || 0) / signal(channels[0]).factor, rising: $("edge").value === "up", before: +$("before").value, once: kind === "once" };
  for (const element of document.querySelectorAll(".triggered")) element.hidden = !kind;
  $("level-unit").textContent = signal(channels[0]).unit;
  view.channels = channels; view.ghost = null; say(request);
  if (kind) { view.sweep = null; drawScope(); }
  phase(kind ? 2 : 0);
}
function phase(number) { const words = ["rolling", "triggered", "waiting for the trigger", "one sweep"][number]; if ($("phase").textContent !== words) $("phase").textContent = words; }
for (const id of ["channel-a", "channel-b", "window", "trigger", "edge", "level", "before"]) $(id).onchange = askScope;
function numbers(values) {
  if (values[0] === 2) { view.sounds++; play(values[1], values.subarray(2)); return; }
  // Ignores a rolling sweep that arrives after a trigger was requested.
  if (values[1] === 0 && $("trigger").value) return;
  phase(values[1]);
  // In hold mode the last sweep stays while the scope waits for the next crossing.
  if (values[1] === 2 && $("trigger").value === "hold") return;
  view.sweep = values; view.sweeps++; drawScope();
}
// The range of each signal's axis grows with the data and does not shrink, so that a quiet wall looks quiet after a
// wall that buzzed.
let axes = {};
function fit() { axes = {}; view.ghost = null; drawScope(); }
$("fit").onclick = fit;
function axis(label, low, high) {
  const kept = axes[label], least = { N: 2, mm: 1, "mm/s": 10, mJ: 1, "mN m": 10 }[signal(label).unit] || 1e-6;
  if (kept && low >= kept.low && high <= kept.high) return kept;
  [low, high] = [Math.min(low, kept?.low ?? low), Math.max(high, kept?.high ?? high)];
  const more = Math.max(.05 * (high - low), (least - high + low) / 2);
  [low, high] = [low < (kept?.low ?? Infinity) ? low - more : low, high > (kept?.high ?? -Infinity) ? high + more : high];
  return axes[label] = { step: nice(1.3 * (high - low)), low, high };
}
// Returns the smallest and largest number of a signal in each column of a sweep, in its axis's unit.
function pairs(sweep, channel) {
  const columns = sweep[5], at = 6 + 2 * columns * channel, factor = signal(view.channels[channel]).factor;
  return Array.from({ length: columns }, (_, i) => [factor * sweep[at + 2 * i], factor * sweep[at + 2 * i + 1]]);
}
function drawScope() {
  const [c, w, h, size] = prepareCanvas($("scope")), s = view.sweep; if (!s || !view.channels) return;
  const [, kind, seconds, crossing, channels] = s, two = channels > 1;
  const left = 3.6 * size, right = w - (two ? 3.8 * size : 8), top = 1.5 * size, foot = h - 1.6 * size, X = t => left + t / seconds * (right - left);
  c.lineWidth = 1; c.textAlign = "center";
  for (let i = 0; i <= 5; i++) {
    const t = seconds * i / 5;
    c.strokeStyle = palette.line; c.beginPath(); c.moveTo(X(t), top); c.lineTo(X(t), foot); c.stroke();
    c.fillStyle = palette.dim; if (i > 0 && i < 5) c.fillText(seconds < 1 ? tick(1e3 * (t - crossing)) + " ms" : tick(t - crossing) + " s", X(t), h - .4 * size);
  }
  const trace = (values, Y) => {
    c.beginPath(); let pen = false;
    values.forEach(([a, b], i) => {
      if (!(a <= b)) { pen = false; return; }
      const x = left + (i + .5) / values.length * (right - left);
      pen ? c.lineTo(x, Y(a)) : c.moveTo(x, Y(a)); pen = true; if (b > a) c.lineTo(x, Y(b));
    });
    c.stroke();
  };
  for (let channel = channels - 1; channel >= 0; channel--) {
    const label = view.channels[channel], { name, unit } = signal(label), values = pairs(s, channel);
    let [low, high] = [Infinity, -Infinity];
    for (const [a, b] of values) { if (a < low) low = a; if (b > high) high = b; }
    if (low > high) continue;
    const range = axis(label, low, high), Y = v => foot - (v - range.low) / (range.high - range.low) * (foot - top), own = channel ? palette.b : palette.a;
    c.lineWidth = 1; c.fillStyle = own; c.textAlign = channel ? "left" : "right";
    for (let k = Math.ceil(range.low / range.step - 1e-9); k * range.step <= range.high * (1 + 1e-9) + 1e-12; k++) {
      const y = Y(k * range.step);
      if (!channel) { c.strokeStyle = palette.line; c.beginPath(); c.moveTo(left, y); c.lineTo(right, y); c.stroke(); }
      if (y > top + .3 * size) c.fillText(tick(k * range.step), channel ? right + 5 : left - 5, y + .35 * size);
    }
    c.textAlign = channel ? "right" : "left";
    c.fillText(name + (unit && ", " + unit), channel ? w - 4 : 4, size);
    if (!channel && view.ghost) {
      c.strokeStyle = palette[view.ghost.mode]; c.lineWidth = 1.2; c.setLineDash(view.ghost.mode === "off" ? [6, 3] : DASH[view.ghost.mode]); c.globalAlpha = .8; trace(view.ghost.values, Y); c.globalAlpha = 1; c.setLineDash([]);
      c.fillStyle = palette.ink; c.textAlign = "center"; c.fillText("╌ before: " + NAMES[view.ghost.mode], (left + right) / 2, size);
    }
    if (!channel && $("trigger").value) {
      const y = Y($("level").valueAsNumber || 0);
      if (y >= top && y <= foot) { c.strokeStyle = own; c.lineWidth = 1; c.setLineDash([2, 4]); c.beginPath(); c.moveTo(left, y); c.lineTo(right, y); c.stroke(); c.setLineDash([]); c.fillStyle = own; c.textAlign = "left"; c.fillText("level", left + 4, y - 3); }
    }
    c.strokeStyle = own; c.lineWidth = channel ? 1.2 : 1.8; trace(values, Y);
  }
  if (kind === 1 || kind === 3) { c.strokeStyle = palette.dim; c.lineWidth = 1; c.setLineDash([4, 4]); c.beginPath(); c.moveTo(X(crossing), top); c.lineTo(X(crossing), foot); c.stroke(); c.setLineDash([]); }
}

// ---- before and after ---------------------------------------------------------------------------------------------
// Compares the ripple of the pressed wall with the ripple under the previous feed-forward.
let now = null, before = null;
function compareRipple(p) {
  const wall = view.walls[view.wall], n = p.numbers, pressed = p.state === "Armed" && n.depth > 0 && n.wall === view.wall;
  if (wall && now?.mode !== wall.feed_forward) {
    if (now?.ripple !== null && now) { before = now; if (view.sweep && view.pressed) view.ghost = { mode: now.mode, values: pairs(view.sweep, 0) }; }
    now = { mode: wall.feed_forward, ripple: null, since: p.time };
  }
  if (!wall || !pressed) { if (now) now.since = p.time; }
  // Skips the first 0.3 s, which belong to the previous mode or to the touch.
  else if (p.time - now.since > 0.3) { now.ripple = n.ripple; now.frequency = n.frequency; }
  view.pressed = pressed; view.buzz = pressed && n.ripple > BUZZES ? n.frequency : null;
  const words = part => `${NAMES[part.mode]} ${part.ripple === null ? "–" : digits(part.ripple, 2) + " N"}`;
  $("ripple-before").textContent = before ? words(before) + " →" : "";
  $("ripple-now").textContent = now ? words(now) : "–";
  $("ripple-now").classList.toggle("hot", pressed && !!now && now.ripple > BUZZES);
  $("buzz").textContent = view.buzz ? `at ${digits(view.buzz, 2)} Hz` : "";
  const limited = pressed && n.saturated > LIMITED;
  $("predicted").textContent = limited ? "motors at their limit: press more gently" : view.buzz && view.predictedBuzz ? `predicted ${digits(view.predictedBuzz, 2)} Hz` : "";
  const [free, kept] = (n.inertia || []).map(inKilograms), coupled = n.inertia && n.inertia[1] > 1.005 * n.inertia[0];
  const effect = !wall || !n.inertia ? "" : !coupled ? `the tip does not swerve here: with and without feed-forward the wall meets ${free}` : {
    off: `off: the wall meets ${free}, because the tip may swerve sideways`,
    full: `full: torques that stop the swerve, so the wall meets ${kept}; a resting hand is pushed sideways`,
    washout: `washed out: torques that stop the swerve, so the wall meets ${kept}; they fade for a resting hand`,
  }[wall.feed_forward];
  if ($("effect").textContent !== effect) $("effect").textContent = effect;
}
function resetComparison() { now = before = null; fit(); }

// ---- sound --------------------------------------------------------------------------------------------------------
// A tone whose loudness follows the torque: a buzz of 73 Hz is audible as 220 Hz plus and minus 73 Hz, which small
// speakers can play.
const TONE = 220;
let sound = null, until = 0;
$("sound").onclick = () => {
  if (sound) { sound.context.close(); sound = null; say({ do: "sound", on: false }); }
  else {
    const context = new AudioContext(), high = new BiquadFilterNode(context, { type: "highpass", frequency: 25 }), limit = new DynamicsCompressorNode(context);
    const tone = new OscillatorNode(context, { frequency: TONE }), swing = new GainNode(context, { gain: 0 }), loud = new GainNode(context, { gain: 2 });
    high.connect(swing.gain); tone.connect(swing).connect(loud).connect(limit).connect(context.destination); tone.start();
    sound = { context, into: high }; until = 0; say({ do: "sound", on: true });
  }
  $("sound").classList.toggle("on", !!sound); $("sound").setAttribute("aria-pressed", !!sound);
};
function play(rate, samples) {
  if (!sound || !samples.length) return;
  const repeat = Math.max(1, Math.ceil(8000 / rate)), buffer = sound.context.createBuffer(1, samples.length * repeat, Math.min(96000, rate * repeat)), data = buffer.getChannelData(0);
  for (let i = 0; i < data.length; i++) data[i] = samples[Math.floor(i / repeat)];
  const source = new AudioBufferSourceNode(sound.context, { buffer });
  source.connect(sound.into);
  // After the last piece has ended, build up a tenth of a second of reserve again.
  if (until < sound.context.currentTime) until = sound.context.currentTime + .1;
  if (until < sound.context.currentTime + .5) { source.start(until); until += buffer.duration; }
}
