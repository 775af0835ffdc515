// ---- scope --------------------------------------------------------------------------------------------------------
$("window").replaceChildren(...[.005, .01, .02, .05, .1, .2, .5, 1, 2].map(s => new Option(s < 1 ? s * 1000 + " ms" : s + " s", s)));
$("window").value = ".2"; $("window").selectedIndex = 5;
function askScope() {
  if (!view.hello) return;
  const channels = [$("channel-a").value, $("channel-b").value].filter(name => name);
  const request = { do: "scope", channels, seconds: +$("window").value };
  if ($("trigger").value) request.trigger = { channel: channels[0], level: $("level").valueAsNumber || 0, rising: $("edge").value === "up", before: +$("before").value, once: $("trigger").value === "once" };
  view.channels = channels; say(request);
  if (request.trigger) { view.sweep = null; drawScope(); }
  $("phase").textContent = request.trigger ? "waiting for the trigger" : "rolling";
}
for (const id of ["channel-a", "channel-b", "window", "trigger", "edge", "level", "before"]) $(id).onchange = askScope;
function numbers(values) {
  // A rolling sweep that was under way when a trigger was asked for is not what is waited for.
  if (values[0] === 1 && values[1] === 0 && $("trigger").value) return;
  if (values[0] === 1) { view.sweep = values; view.sweeps++; drawScope(); } else if (values[0] === 2) { view.sounds++; play(values[1], values.subarray(2)); }
}
function drawScope() {
  const [c, w, h] = fresh($("scope")), s = view.sweep; if (!s) return;
  const [, phase, seconds, crossing, channels, columns] = s;
  $("phase").textContent = ["rolling", "triggered", "waiting for the trigger", "one sweep"][phase];
  const left = 4, right = w - 4, top = 8, foot = h - 20, X = t => left + t / seconds * (right - left);
  c.strokeStyle = palette.line; c.fillStyle = palette.dim; c.lineWidth = 1; c.textAlign = "center";
  for (let i = 0; i <= 5; i++) { const t = seconds * i / 5; c.beginPath(); c.moveTo(X(t), top); c.lineTo(X(t), foot); c.stroke(); if (i > 0 && i < 5) c.fillText(seconds < 1 ? digits(1e3 * (t - crossing)) + " ms" : digits(t - crossing) + " s", X(t), h - 5); }
  if (phase === 1 || phase === 3) { c.strokeStyle = palette.dim; c.setLineDash([4, 4]); c.beginPath(); c.moveTo(X(crossing), top); c.lineTo(X(crossing), foot); c.stroke(); c.setLineDash([]); }
  for (let channel = 0; channel < channels; channel++) {
    const at = 6 + 2 * columns * channel; let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < columns; i++) { if (s[at + 2 * i] < low) low = s[at + 2 * i]; if (s[at + 2 * i + 1] > high) high = s[at + 2 * i + 1]; }
    const name = view.channels[channel] || "";
    c.fillStyle = c.strokeStyle = channel ? palette.b : palette.a; c.textAlign = channel ? "right" : "left"; c.lineWidth = 1.6;
    if (low > high) continue;
    c.fillText(`${name}: ${digits(low)} to ${digits(high)}`, channel ? right - 4 : left + 4, top + 12);
    const room = Math.max(high - low, 1e-9, 1e-3 * Math.abs(high)), middle = (low + high) / 2, Y = v => (top + foot) / 2 + 8 - (v - middle) / room * (foot - top - 44) ;
    c.beginPath(); let pen = false;
    for (let i = 0; i < columns; i++) {
      const a = s[at + 2 * i], b = s[at + 2 * i + 1]; if (!(a <= b)) { pen = false; continue; }
      const x = left + (i + .5) / columns * (right - left);
      pen ? c.lineTo(x, Y(a)) : c.moveTo(x, Y(a)); pen = true; if (b > a) c.lineTo(x, Y(b));
    }
    c.stroke();
  }
}

// ---- sound --------------------------------------------------------------------------------------------------------
let sound = null, until = 0;
$("sound").onclick = () => {
  if (sound) { sound.context.close(); sound = null; say({ do: "sound", on: false }); }
  else {
    const context = new AudioContext(), high = new BiquadFilterNode(context, { type: "highpass", frequency: 25 }), gain = new GainNode(context, { gain: .5 }), limit = new DynamicsCompressorNode(context);
    high.connect(gain).connect(limit).connect(context.destination);
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
  until = Math.max(until, sound.context.currentTime + .04);
  if (until < sound.context.currentTime + .5) { source.start(until); until += buffer.duration; }
}

theme(prefersDark.matches);
connect();
