"use strict";
const $ = id => document.getElementById(id);
const view = { pictures: 0, sweeps: 0, sounds: 0, you: 0, hello: null, walls: [], springs: [], field: 0, plane: null, last: null, wall: 0, down: false, fast: false, trail: [], recent: [], box: null };
window.view = view;
// Ripple (N rms) above which a wall buzzes, and share of time at a limit above which no wall is felt. Each feed-forward
// has the same dashes and colour in every picture.
const BUZZES = 0.5, LIMITED = 0.2, DASH = { off: [], full: [9, 4], washout: [2, 3.5] };

// ---- the link -----------------------------------------------------------------------------------------------------
// Connects to the tool by a WebSocket; in the page as a file, to the library in a worker (clients/page/).
const carrier = window.playground || (() => new WebSocket("ws://" + location.host + "/live" + location.search));
let socket = null;
function say(message) { if (socket && socket.readyState === 1) socket.send(JSON.stringify(message)); }
function connect() {
  socket = carrier();
  socket.binaryType = "arraybuffer";
  // The board behind a new connection is not known before its hello.
  socket.onopen = () => { view.takes = true; view.hello = view.frame = null; if (sound) say({ do: "sound", on: true }); };
  socket.onmessage = event => typeof event.data === "string" ? receive(JSON.parse(event.data)) : numbers(new Float32Array(event.data));
  socket.onclose = () => { up(); lost("not connected" + (view.last ? ": " + view.last.if_lost : "")); setTimeout(connect, 1000); };
}
function lost(why) { $("state").textContent = "no connection"; $("state").className = "pill lost"; document.body.dataset.state = "Lost"; notice(why, { of: "lost" }); }
function receive(message) {
  switch (message.is) {
    case "you": view.you = message.you; break;
    case "hello": hello(message); break;
    case "walls": view.walls = message.walls; view.springs = message.springs; view.field = message.field_damping; showGains(); if (view.of === "gains") notice(""); break;
    case "recorded": notice(message.words, {}, true); break;
    case "plane": view.plane = message.plane; break;
    case "picture": picture(message); break;
    case "refused": if (!(view.last && view.last.held)) { up("quietly"); armAfter = performance.now() + 3000; } notice(message.why, message); showGains(message.of === "gains"); break;
    case "lost": lost(message.why); break;
  }
}
function hello(message) {
  const name = [message.device, message.scene, message.simulated].join(), other = view.name !== name;
  view.name = name; view.hello = message; view.trail = []; view.recent = []; view.box = view.fault = view.still = slow = null; view.pressedAt = view.missed = NaN;
  $("device").textContent = message.device;
  document.title = message.device + ": haptic view";
  $("board").textContent = (message.simulated ? "simulated" + (message.weightless ? ", without its weight" : "") : message.board + " " + message.serial + " on " + message.port) +
    (message.rows_hz < message.rate_hz ? ", " + unit(message.rows_hz, "Hz") + " shown" : "");
  if (other) { view.firstRate = message.rate_hz; document.body.classList.toggle("real", !message.simulated); unfold(!message.simulated); }
  if (view.next) [view.wanted, view.next] = [view.next, null];
  listWorlds(message);
  $("hint").textContent = message.smooth ? "A tenth of the device's dry friction, encoders five times as fine." : "";
  $("key").firstChild.data = message.simulated ? "Motors on or off" : "Hold: motors on";
  $("key").querySelector("small").textContent = message.simulated ? "simulated motors need no key" : coarse ? "letting go turns them off" : "Space, or press here; letting go turns them off";
  for (const id of ["let-go", "start-over", "beyond-label"]) $(id).hidden = message.simulated === (id === "beyond-label");
  $("rail").parentElement.hidden = !message.smooth;
  $("record").hidden = !message.records;
  setSignals(message.columns); resetComparison();
  askScope();
  if (view.of !== "link" && !$("notice").classList.contains("good")) notice("");
}
// A notice disappears with its cause: a notice about gains after other gains are set, about the connection after a new
// connection, about a link with the next link, and the following notices when a picture shows that their cause is over.
const OVER = {
  inside: p => !(p.numbers.depth > 0), watching: p => p.command === null || p.command === view.you, nobody: p => p.command !== null,
  off: p => p.state === "Armed", fault: p => !p.fault,
};
function notice(why, { of, again } = {}, good) {
  $("notice").classList.toggle("shown", !!why); $("notice").classList.toggle("good", !!good);
  $("why").textContent = why || "";
  $("anyway").hidden = !again;
  if (again) $("anyway").textContent = `Set ${unit(again.stiffness, "N/m")}, ${unit(again.damping, "N s/m")}, feed-forward ${NAMES[again.feed_forward]} anyway`;
  view.again = again; view.of = of;
}
$("anyway").onclick = () => { const again = view.again; notice(""); say(again); };
$("dismiss").onclick = () => notice("");
// A notice about a completed action disappears by itself.
function done(why) { notice(why, {}, true); setTimeout(() => { if ($("why").textContent === why) notice(""); }, 4000); }

// ---- the dead man's key -------------------------------------------------------------------------------------------
// With the key the page sends the step of the newest picture that it had when it saw the key: half a second after that
// step the board turns the motors off, however slow the link is.
let beat = 0, lastBeat = 0;
const seen = () => view.last ? view.last.step : 0;
function hold() { const now = performance.now(); if (view.down && now - lastBeat > 60) { lastBeat = now; say({ do: "hold", seen: seen() }); } }
function press() {
  if (view.down) return;
  view.down = true;
  if (!simulated()) notice("");
  say({ do: "arm", seen: seen() });
  beat = setInterval(hold, 80);
  $("key").classList.add("down");
}
function up(quietly) {
  if (!view.down) return;
  view.down = false; clearInterval(beat);
  if (!quietly || (view.last && view.last.held)) say({ do: "release" });
  $("key").classList.remove("down");
}
// On a real board Space is the key wherever the focus is, except where a space can be typed; Enter ends typing.
// Simulated motors need no key (stage.js): a click of the button turns them on or off.
const typing = target => target.matches?.("input[type=number], input[type=text], textarea");
addEventListener("keydown", event => { if (event.key === "Enter" && typing(event.target)) event.target.blur(); });
addEventListener("keydown", event => { if (event.code === "Space" && !typing(event.target) && !simulated()) { event.preventDefault(); if (!event.repeat) press(); } });
addEventListener("keyup", event => { if (event.code === "Space" && !simulated()) { if (!typing(event.target)) event.preventDefault(); up(); } });
$("key").onpointerdown = event => { if (!simulated()) { $("key").setPointerCapture(event.pointerId); press(); } };
$("key").onpointerup = $("key").onpointercancel = $("key").onlostpointercapture = () => { if (!simulated()) up(); };
$("key").onclick = () => { if (simulated()) { stopped = view.down; stopped ? up() : press(); } };
$("key").oncontextmenu = event => event.preventDefault();
addEventListener("blur", () => { if (!simulated()) up(); });
addEventListener("pagehide", () => up());
document.addEventListener("visibilitychange", () => { if (document.hidden && !simulated()) up(); });
// While one finger holds the key, the browser makes no click for a second finger.
let second = null;
const buttonOf = element => element?.closest?.("button:not(#key)");
addEventListener("pointerdown", event => { if (event.pointerType === "touch" && !event.isPrimary) second = buttonOf(event.target); }, true);
addEventListener("pointerup", event => {
  if (event.pointerType !== "touch" || event.isPrimary || !second) return;
  if (second === buttonOf(document.elementFromPoint(event.clientX, event.clientY))) second.click();
  second = null;
}, true);
const coarse = matchMedia("(pointer: coarse)").matches;
$("take").onclick = () => { view.gave = view.last?.command === view.you; say({ do: view.gave ? "give" : "take" }); };
$("off").onclick = () => { stopped = true; up(); say({ do: "disarm" }); };
function unfold(open) { document.body.classList.toggle("more", open); $("more").setAttribute("aria-expanded", open); }
$("more").onclick = () => unfold(!document.body.classList.contains("more"));
// ---- device and rate of a simulation ------------------------------------------------------------------------------
const RATES = [500, 1000, 2000, 5000];
function listWorlds({ simulated, worlds, device, scene, rate_hz }) {
  const name = device + (scene ? "/" + scene : ""), known = simulated ? worlds : [], mine = known.findIndex(world => world.startsWith(name + ":"));
  $("choice").replaceChildren(...(mine < 0 ? [new Option(name, "")] : []), ...known.map((world, i) => new Option(world, i)));
  $("choice").value = mine < 0 ? "" : mine;
  const rates = simulated ? [...new Set([...RATES, rate_hz])].sort((a, b) => a - b) : [rate_hz];
  $("rate").replaceChildren(...rates.map(hz => new Option(unit(hz, "Hz"), hz)));
  $("rate").value = rate_hz;
  $("choice").disabled = $("rate").disabled = !simulated;
}
$("choice").onchange = () => { if ($("choice").value) say({ do: "world", world: +$("choice").value }); };
$("rate").onchange = () => { resetComparison(); say({ do: "rate", hz: +$("rate").value }); };
$("clear").onclick = () => say({ do: "clear" });
$("record").onclick = () => say({ do: "record", on: !view.last.recording });
setInterval(() => say({ do: "here" }), 1000);

// ---- words and numbers --------------------------------------------------------------------------------------------
function digits(value, count = 3) {
  if (value === null || !isFinite(value)) return "–";
  const size = Math.abs(value);
  return value.toFixed(size === 0 ? 0 : Math.max(0, Math.min(6, count - 1 - Math.floor(Math.log10(size)))));
}
function unit(value, name) {
  const size = Math.abs(value);
  if (size >= 1e6) return digits(value / 1e6) + " M" + name;
  if (size >= 1e3) return digits(value / 1e3) + " k" + name;
  if (size > 0 && size < 1e-4 && name !== "") return digits(value * 1e6) + " µ" + name;
  if (size > 0 && size < 0.1 && name !== "") return digits(value * 1e3) + " m" + name;
  return digits(value) + " " + name;
}
const inKilograms = value => value < 1 ? digits(value * 1e3) + " g" : digits(value) + " kg";
function picture(p) {
  // Timers may get no time, so pictures also report a held key. This one may arrive after the key was released.
  hold();
  view.last = p; view.pictures++;
  view.trail.push(...p.trail);
  view.recent.push(p.trail); if (view.recent.length > 9) view.recent.shift();
  if (view.trail.length > 1500) view.trail.splice(0, view.trail.length - 1500);
  document.body.dataset.state = p.state;
  $("state").textContent = { Disarmed: "motors off", Armed: "motors on", CheckingPolarity: "checking polarity", Fault: "fault", Homing: "homing" }[p.state];
  $("state").className = "pill" + (p.state === "Armed" ? " armed" : p.state === "Fault" ? " fault" : "");
  const mine = p.command === view.you;
  // A new page takes command, unless another page has it; so does the page of a simulation that lost it in the background.
  view.had ||= mine;
  if ((view.takes || simulated() && view.had && !view.gave) && p.command === null) say({ do: "take" });
  view.takes = false;
  if (view.wanted && mine && view.hello) follow();
  // A press may have been sent before a refusal arrived, and armed after the page released its key.
  if (mine && p.held && !view.down) say({ do: "release" });
  // Something else turned the motors off: the key must be pressed again.
  if (view.down && view.wasHeld && !p.held) up("quietly");
  view.wasHeld = view.down && p.held;
  if (mine) runByItself(p);
  document.body.dataset.role = mine ? "command" : "watch";
  // A single page has no other page to give command to.
  const alone = mine && p.pages < 2;
  $("role").textContent = alone ? touched || !railed() ? "" : "runs by itself" : (mine ? "you command" : p.command ? "another page commands" : "no page commands") + (p.pages > 1 ? `, ${p.pages} pages` : "");
  $("take").textContent = mine ? "Give back" : "Take command"; $("take").hidden = alone;
  $("take").disabled = !mine && p.command !== null;
  $("key").disabled = !mine || p.state === "Fault";
  // During a fault the remedy stays visible.
  const faulty = p.state === "Fault";
  $("clear").hidden = !faulty; $("dismiss").hidden = faulty; $("anew").hidden = !(faulty || view.of === "inside") || !view.hello?.simulated;
  $("record").disabled = !mine; $("record").classList.toggle("on", !!p.recording); $("record").setAttribute("aria-pressed", !!p.recording);
  $("record").textContent = p.recording ? `Recording, ${(p.recording.bytes / 1e6).toFixed(1)} MB` : "Record"; $("record").title = p.recording ? p.recording.file : "Record to a file where the tool runs";
  if (p.fault && (p.fault !== view.fault || !$("notice").classList.contains("shown"))) notice("Fault: " + p.fault, { of: "fault" });
  view.fault = p.fault;
  if (OVER[view.of]?.(p)) notice("");
  compareRipple(p); describe(p); markGains(p);
  const n = p.numbers, inside = n.depth > 0;
  const shown = [
    ["Force", unit(n.force, "N")], ["Depth", inside ? unit(n.depth, "m") : "outside"], ["Sideways push", unit(n.sideways, "N")],
    ["Ripple", unit(n.ripple, "N") + " rms", n.ripple > BUZZES], ["Power given out", p.state === "Armed" ? unit(Math.max(0, n.power), "W") : "–", p.state === "Armed" && n.power > GLOWS],
    ["Cut by a limit", digits(100 * n.saturated, 2) + " %", n.saturated > 0],
    ["Inertia off / full", n.inertia ? inKilograms(n.inertia[0]) + " / " + inKilograms(n.inertia[1]) : "–"],
    ["Rows lost", String(p.lost), p.lost > 0],
    p.speed === null ? ["Interrupt load", p.load === null ? "–" : digits(100 * p.load, 2) + " %", p.load > 0.9] : ["Simulation speed", digits(100 * p.speed, 3) + " %", p.speed < 0.9],
    ...n.sensed.map((angle, i) => [`Sensed ${i}`, unit(angle, "rad")]),
  ];
  const list = $("numbers");
  if (list.children.length !== shown.length) list.replaceChildren(...shown.map(() => { const d = document.createElement("div"); d.append(document.createElement("dt"), document.createElement("dd")); return d; }));
  shown.forEach(([name, value, hot], i) => { const [dt, dd] = list.children[i].children; dt.textContent = name; dd.textContent = value; dd.className = hot ? "hot" : ""; });
  // Thirty pictures a second leave a slow computer time to report that the key is down, and fewer leave it time to simulate.
  if (view.pictures % (p.speed !== null && p.speed < .8 ? 5 : 2) === 0) requestDraw(view.pictures % 10 !== 0);
}

