// ---- scope --------------------------------------------------------------------------------------------------------
// Telemetry signals by the first word of their label (of a slide with its unit): displayed name, unit of the axis, and
// factor from SI to that unit.
const SIGNALS = {
  rendered: ["wall force", "N", 1], force: ["requested wall force", "N", 1], distance: ["distance to the wall", "mm", 1e3], velocity: ["speed along the normal", "mm/s", 1e3],
  energy: ["energy taken up", "mJ", 1e3], tip_x: ["tip x", "mm", 1e3], tip_y: ["tip y", "mm", 1e3], tip_z: ["tip z", "mm", 1e3], tip: ["tip", "mm", 1e3],
  q: ["angle", "°", 180 / Math.PI], q_m: ["travel", "mm", 1e3], torque: ["torque", "mN m", 1e3], torque_n: ["motor force", "N", 1], saturated: ["limited", "", 1], counts: ["encoder", "counts", 1], state: ["state", "", 1], contacts: ["walls touched", "", 1],
};
function signal(label) {
  const [, word, joint, suffix] = /^(tip_[xyz]|[a-z]+)(\d*)(.*)/.exec(label), [name, unit, factor] = SIGNALS[word + suffix] || SIGNALS[word] || [label, "", 1];
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
  // The slow motion needs the wall's force and distance.
  const all = [...new Set([...channels, "rendered_n", "distance_m"])], request = { do: "scope", channels: all, seconds: +$("window").value };
  if (kind) request.trigger = { channel: channels[0], level: ($("level").valueAsNumber || 0) / signal(channels[0]).factor, rising: $("edge").value === "up", before: +$("before").value, once: kind === "once" };
  for (const element of document.querySelectorAll(".triggered")) element.hidden = !kind;
  $("level-unit").textContent = signal(channels[0]).unit;
  view.channels = all; view.shown = channels.length; view.ghost = null; say(request);
  if (kind) { view.sweep = null; drawScope(); }
  phase(kind ? 2 : 0);
}
function phase(number) { const words = ["rolling", "triggered", "waiting for the trigger", "one sweep"][number]; if ($("phase").textContent !== words) $("phase").textContent = words; }
for (const id of ["channel-a", "channel-b", "window", "trigger", "edge", "level", "before"]) $(id).onchange = askScope;
function numbers(values) {
  if (values[0] === 2) { view.sounds++; play(values[1], values.subarray(2)); return; }
  // A rolling sweep may still arrive after a trigger was requested: ignore it.
  if (values[1] === 0 && $("trigger").value) return;
  phase(values[1]);
  // In hold mode the last crossing stays while the scope waits for the next.
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
  const [, kind, seconds, crossing] = s, channels = view.shown, two = channels > 1, wall = view.walls[view.wall];
  if (s[4] !== view.channels.length) return;
  const left = 3.6 * size, right = w - (two ? 3.8 * size : 8), top = 1.5 * size, foot = h - 1.6 * size, X = t => left + t / seconds * (right - left);
  c.lineWidth = 1; c.textAlign = "center";
  for (let i = 0; i <= 5; i++) {
    const t = seconds * i / 5;
    c.strokeStyle = palette.line; c.beginPath(); c.moveTo(X(t), top); c.lineTo(X(t), foot); c.stroke();
    c.fillStyle = palette.dim; if (i > 0 && i < 5) c.fillText(seconds < 1 ? tick(1e3 * (t - crossing)) + " ms" : tick(t - crossing) + " s", X(t), h - .4 * size);
  }
  const trace = (values, Y, about) => {
    c.beginPath(); let pen = false;
    if (about !== undefined) { c.moveTo(left, Y(about)); pen = true; }
    values.forEach(([a, b], i) => {
      if (!(a <= b)) { pen = false; return; }
      const x = left + (i + .5) / values.length * (right - left);
      pen ? c.lineTo(x, Y(a)) : c.moveTo(x, Y(a)); pen = true; if (b > a) c.lineTo(x, Y(b));
    });
    if (about !== undefined) { c.lineTo(right, Y(about)); c.fill(); }
    c.stroke();
  };
  for (let channel = channels - 1; channel >= 0; channel--) {
    const label = view.channels[channel], { name, unit } = signal(label), values = pairs(s, channel);
    let [low, high] = [Infinity, -Infinity];
    for (const [a, b] of values) { if (a < low) low = a; if (b > high) high = b; }
    if (low > high) continue;
    const range = axis(label, low, high), Y = v => foot - (v - range.low) / (range.high - range.low) * (foot - top), own = label === "rendered_n" && wall ? palette[wall.feed_forward + "-name"] : channel ? palette.dim : palette.ink;
    c.lineWidth = 1; c.fillStyle = own; c.textAlign = channel ? "left" : "right";
    for (let k = Math.ceil(range.low / range.step - 1e-9); k * range.step <= range.high * (1 + 1e-9) + 1e-12; k++) {
      const y = Y(k * range.step);
      if (!channel) { c.strokeStyle = palette.line; c.beginPath(); c.moveTo(left, y); c.lineTo(right, y); c.stroke(); }
      if (y > top + .3 * size) c.fillText(tick(k * range.step), channel ? right + 5 : left - 5, y + .35 * size);
    }
    c.textAlign = channel ? "right" : "left";
    c.fillText(name + (unit && ", " + unit), channel ? w - 4 : 4, size);
    if (!channel && view.ghost) {
      // Before: pale and filled about its mean; now: bold, in its own colour.
      const past = view.ghost.values.filter(([a, b]) => a <= b), middle = past.reduce((sum, [a, b]) => sum + a + b, 0) / past.length / 2;
      c.strokeStyle = palette.hatch; c.fillStyle = palette.before; c.lineWidth = .8; trace(past, Y, middle);
    }
    if (!channel && $("trigger").value) {
      const y = Y($("level").valueAsNumber || 0);
      if (y >= top && y <= foot) { c.strokeStyle = own; c.lineWidth = 1; c.setLineDash([2, 4]); c.beginPath(); c.moveTo(left, y); c.lineTo(right, y); c.stroke(); c.setLineDash([]); c.fillStyle = own; c.textAlign = "left"; c.fillText("level", left + 4, y - 3); }
    }
    c.strokeStyle = own; c.lineWidth = channel ? 1.4 : 2.6; trace(values, Y);
    if (!channel && view.ghost && wall) {
      const words = "now: " + nameOf(wall.feed_forward);
      c.textAlign = "right"; c.fillStyle = own; c.font = `700 ${size}px system-ui, sans-serif`; c.fillText(words, right, size);
      const wide = c.measureText(words).width; c.font = `${size}px system-ui, sans-serif`; c.fillStyle = palette.dim; c.fillText("before: " + nameOf(view.ghost.mode), right - wide - size, size);
    }
  }
  if (kind === 1 || kind === 3) { c.strokeStyle = palette.dim; c.lineWidth = 1; c.setLineDash([4, 4]); c.beginPath(); c.moveTo(X(crossing), top); c.lineTo(X(crossing), foot); c.stroke(); c.setLineDash([]); }
}

// ---- before and now -----------------------------------------------------------------------------------------------
// The ripple of the pressed wall, compared with the ripple under the previous feed-forward; at a limit of the motors
// there is none. `measured` is the last buzz, with its prediction.
let now = null, before = null, measured = "";
function compareRipple(p) {
  const wall = view.walls[view.wall], n = p.numbers, pressed = p.state === "Armed" && n.depth > 0 && n.wall === view.wall;
  if (pressed) [view.pressedAt, view.missed] = [p.time, 0];
  // A buzz lifts the tip off between its pushes, and a slow computer draws few pictures of it.
  view.fast = p.state === "Armed" && (p.time - view.pressedAt < LIFTED || view.missed++ < 4);
  view.limited = !!view.fast && n.saturated > LIMITED;
  // Other gains are another wall.
  const gains = wall && [wall.stiffness, wall.damping].join();
  if (now && now.gains !== gains) { now = before = view.ghost = null; measured = ""; }
  if (wall && now?.mode !== wall.feed_forward) {
    if (now?.ripple > 0) { before = now; if (view.sweep && view.fast) view.ghost = { mode: now.mode, values: pairs(view.sweep, 0) }; }
    now = { mode: wall.feed_forward, gains, ripple: null, since: p.time };
    // The sentences of the previous mode are over at once.
    toldAt.told = 0; $("ripple").textContent = "";
  }
  if (now && (!view.fast || view.limited)) { now.since = p.time; if (view.limited) now.ripple = null; }
  // The first tenths of a second still belong to the previous mode, or to the touch.
  else if (now && p.time - now.since > 0.4) { now.ripple = n.ripple; now.settled = p.time - now.since > .8; }
  view.buzz = view.fast && !view.limited && n.ripple > BUZZES ? n.frequency : null;
  if (view.buzz && now.ripple !== null) measured = ` Buzz: ${view.predictedBuzz ? `${digits(view.predictedBuzz, 2)} Hz predicted, ${digits(view.buzz, 2)} measured` : `${digits(view.buzz, 2)} Hz`}.`;
  const times = before?.ripple / now?.ripple, name = part => part.mode === "washout" ? "on" : NAMES[part.mode], many = ratio => ratio < 1.5 ? "as quiet" : ratio < 10 ? digits(ratio, 2) : String(+ratio.toPrecision(2));
  const louder = times < 1 / 1.5, factor = louder ? many(1 / times) : many(times), than = before && (factor === "as quiet" ? "as quiet as" : `${factor} times ${louder ? "louder" : "quieter"} than`);
  const words = view.limited ? "Not rendered: motors at their limit." : !now || now.ripple === null ? "" : before ? `Now ${name(now)}: ${than} ${name(before)}` : `Now ${name(now)}: ripple ${digits(now.ripple, 2)} N`;
  if (words && (now.settled || view.limited)) tell("ripple", words + (view.limited ? "" : "." + measured));
  else if (!words && !view.fast && !now?.ripple) tell("ripple", "");
}
function resetComparison() { now = before = null; measured = ""; fit(); }

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
