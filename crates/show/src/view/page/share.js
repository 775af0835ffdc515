// ---- links --------------------------------------------------------------------------------------------------------
// A link's settings follow its #: device and scene by the names of their files, pose (rad), and for each wall
// stiffness, damping, feed-forward, point, normal. Each lesson is a name, a link, and a task.
const LESSONS = [
  ["1 Why does a wall buzz?", "device=hapkit-paddle/slow", "Press into the wall: quiet. Drag the dot beyond the curve, as to 14 kN/m at 60 N s/m, come out, and strike."],
  ["2 What does the tip weigh?", "device=coupled-five-bar&pose=2.6,1.75&wall=8700,80,washout,-0.11766,0.184342,0.940376,-0.340136", "Move the tip around: the dashed ellipse is the mass that a push meets, by direction."],
  ["3 Why does coupling cost stiffness?", "device=coupled-five-bar&wall=8700,80,full", "Press into the wall with Full, Washed out and Off (More): which one pushes you sideways, which one buzzes?"],
  ["4 Why does friction hide it?", "device=hapkit-paddle/slow&wall=10000,60,off", "This wall is beyond the curve and quiet: friction and the hand hold it. Raise it, or strike it, until it buzzes."],
  ["5 What limits a real wall?", "device=hapkit-paddle/wall&wall=20000,60,off", "Set the scope to 20 ms and move slowly in the wall: each count of the encoder is a step of force."],
];
// Parses a link's settings; a mistake is thrown as text.
function read(hash) {
  const wanted = { walls: [] };
  const numbers = (words, key, counts) => {
    const found = words.map(Number);
    if (!counts.includes(words.length) || !words.every((word, i) => word.trim() && isFinite(found[i]))) throw `the link's ${key} is not ${counts.join(" or ")} numbers`;
    return found;
  };
  for (const [key, value] of new URLSearchParams(hash.replace(/^#/, ""))) {
    const words = value.split(",");
    if (key === "lesson") { if (!LESSONS[value - 1]) throw `the link's lesson is not one of 1 to ${LESSONS.length}`; Object.assign(wanted, read(LESSONS[value - 1][1]), { task: LESSONS[value - 1][2] }); }
    else if (key === "device") wanted.device = value;
    else if (key === "scale") { if (![...$("scale").options].some(option => option.value === value)) throw "the link's scale is not one of the plane's"; wanted.scale = value; }
    else if (key === "pose") wanted.pose = numbers(words, key, [1, 2, 3]);
    else if (key === "wall") {
      const mode = words.splice(2, 1)[0], [stiffness, damping, x, y, ...normal] = numbers(words, "wall (without its feed-forward)", [2, 4, 6]);
      if (!MODES.includes(mode)) throw `the link's feed-forward is not one of ${MODES.join(", ")}`;
      wanted.walls.push({ gains: { stiffness, damping, feed_forward: mode }, point: y === undefined ? null : [x, y], normal });
    } else throw `the link has an unknown part, ${key}`;
  }
  return wanted.device || wanted.scale || wanted.pose || wanted.walls.length ? wanted : null;
}
function readLink() { try { view.wanted = read(location.hash); } catch (why) { view.wanted = null; return why; } return null; }
// Applies a link's settings once a device is known. A link never moves a real device.
function follow() {
  const wanted = view.wanted, { device, pose, walls, scale, task } = wanted;
  view.wanted = null; view.scale = scale; touched = true;
  const not = why => notice(`Nothing was changed: ${why}`, { of: "link" });
  if (!view.hello.simulated) return not("links set up simulated devices only");
  if (device && ![shown(), view.hello.device].includes(device)) {
    const world = view.hello.worlds.findIndex(name => [":", "/"].some(end => name.startsWith(device + end)));
    if (world < 0) return not(`this page does not have the link's device ${device}`);
    // The rest follows when that device is there.
    view.next = wanted;
    return say({ do: "world", world });
  }
  if (walls.length > view.walls.length) return not(`the link has ${walls.length} walls, and this scene ${view.walls.length}`);
  $("rail").checked = !pose && walls.every(wall => !wall.point); armAfter = performance.now() + 1000;
  say({ do: "start-over", ...(pose ? { pose } : {}) });
  walls.forEach(({ gains, point, normal }, wall) => {
    if (point) say({ do: "wall", wall, point, ...(normal.length ? { normal } : {}) });
    say({ do: "gains", wall, ...gains, beyond: true });
  });
  if (task) notice(task, {}, true);
}
const short = value => +value.toPrecision(6);
const shown = () => view.hello.device + (view.hello.scene ? "/" + view.hello.scene : "");
function link() {
  const turned = wall => wall.outline?.is === "line" && view.hello.task > 1;
  const walls = view.walls.map(wall => "wall=" + [short(wall.stiffness), short(wall.damping), wall.feed_forward, ...wall.values.slice(0, 2).map(short), ...(turned(wall) ? wall.values.slice(3, 5).map(short) : [])]);
  return location.href.replace(/[?#].*$/, "") + "#" + ["device=" + shown(), "pose=" + view.last.q.map(short), "scale=" + $("scale").value, ...walls].join("&");
}
$("copy").onclick = async () => {
  history.replaceState(null, "", link());
  try { await navigator.clipboard.writeText(location.href); done("Copied: a link to this device, pose, walls and gains."); }
  catch { done("The link is in the address bar."); }
};
function rereadLink() { const wrong = readLink(); if (wrong || view.of === "link") notice(wrong, { of: "link" }); }
addEventListener("hashchange", rereadLink);
$("lesson").replaceChildren(new Option("Lessons", ""), ...LESSONS.map(([name], i) => new Option(name, i + 1)));
$("lesson").onchange = () => { if ($("lesson").value) location.hash = "lesson=" + $("lesson").value; $("lesson").value = ""; };

const escapeXml = words => words.replace(/[&<>]/g, mark => `&#${mark.charCodeAt(0)};`);

// ---- pictures to keep ---------------------------------------------------------------------------------------------
// Records what is drawn on a canvas as SVG; it supports the canvas commands that this page uses.
class Drawing {
  constructor(width, height, size) {
    Object.assign(this, { width, height, out: [], defs: [], kept: [], d: "", at: [1, 0, 0, 1, 0, 0], dash: [], clipped: "" });
    Object.assign(this, { fillStyle: "#000", strokeStyle: "#000", lineWidth: 1, globalAlpha: 1, textAlign: "left", textBaseline: "alphabetic", font: size + "px sans-serif" });
    this.ruler = document.createElement("canvas").getContext("2d");
  }
  save() { const { at, dash, clipped, fillStyle, strokeStyle, lineWidth, globalAlpha, textAlign, textBaseline, font } = this; this.kept.push({ at, dash, clipped, fillStyle, strokeStyle, lineWidth, globalAlpha, textAlign, textBaseline, font }); }
  restore() { Object.assign(this, this.kept.pop()); }
  turned(a, b, c, d, e, f) { const m = this.at; this.at = [m[0] * a + m[2] * b, m[1] * a + m[3] * b, m[0] * c + m[2] * d, m[1] * c + m[3] * d, m[0] * e + m[2] * f + m[4], m[1] * e + m[3] * f + m[5]]; }
  translate(x, y) { this.turned(1, 0, 0, 1, x, y); }
  rotate(angle) { const [s, c] = [Math.sin(angle), Math.cos(angle)]; this.turned(c, s, -s, c, 0, 0); }
  setLineDash(dash) { this.dash = dash; }
  beginPath() { this.d = ""; }
  moveTo(x, y) { this.d += `M${short(x)} ${short(y)}`; }
  lineTo(x, y) { this.d += `${this.d ? "L" : "M"}${short(x)} ${short(y)}`; }
  closePath() { this.d += "Z"; }
  rect(x, y, w, h) { this.d += `M${short(x)} ${short(y)}h${short(w)}v${short(h)}h${short(-w)}Z`; }
  // Full ellipses only.
  ellipse(x, y, a, b, angle) { const [c, s] = [a * Math.cos(angle), a * Math.sin(angle)], turn = `A${short(a)} ${short(b)} ${short(angle * 180 / Math.PI)} 1 0 `; this.d += `M${short(x + c)} ${short(y + s)}${turn}${short(x - c)} ${short(y - s)}${turn}${short(x + c)} ${short(y + s)}`; }
  arc(x, y, r) { this.ellipse(x, y, r, r, 0); }
  put(element, inside) {
    const own = this.at.join() === "1,0,0,1,0,0" ? "" : ` transform="matrix(${this.at.map(short)})"`, seen = this.globalAlpha < 1 ? ` opacity="${short(this.globalAlpha)}"` : "";
    this.out.push(`<g${this.clipped}><${element}${own}${seen}${inside === undefined ? "/>" : `>${inside}</${element.split(" ")[0]}>`}</g>`);
  }
  stroke() { if (this.d) this.put(`path d="${this.d}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-linejoin="round"${this.dash.length ? ` stroke-dasharray="${this.dash}"` : ' stroke-linecap="round"'}`); }
  fill(rule) { if (this.d) this.put(`path d="${this.d}" fill="${this.fillStyle}"${rule ? ` fill-rule="${rule}"` : ""}`); }
  fillRect(x, y, w, h) { this.put(`rect x="${short(x)}" y="${short(y)}" width="${short(w)}" height="${short(h)}" fill="${this.fillStyle}"`); }
  clip() { this.defs.push(`<clipPath id="clip${this.defs.length}"><path d="${this.d}"/></clipPath>`); this.clipped = ` clip-path="url(#clip${this.defs.length - 1})"`; }
  measureText(words) { this.ruler.font = this.font; return this.ruler.measureText(words); }
  words(words, x, y, paint) {
    const [, weight, pixels] = /^(\d+ )?([\d.]+)px/.exec(this.font), size = +pixels, anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
    const low = this.textBaseline === "middle" ? .35 * size : 0;
    this.put(`text x="${short(x)}" y="${short(y + low)}" font-size="${short(size)}"${weight ? ` font-weight="${weight.trim()}"` : ""} text-anchor="${anchor}" ${paint}`, escapeXml(words));
  }
  fillText(words, x, y) { this.words(words, x, y, `fill="${this.fillStyle}"`); }
  strokeText(words, x, y) { this.words(words, x, y, `fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}"`); }
}
// Returns one of the three pictures at the width of a column (85 mm) or a page (170 mm) of a paper, in letters of 8
// points, on white.
function svgOf(what, millimetres) {
  const size = 8 * 96 / 72, width = millimetres * 96 / 25.4, height = width * { stage: .8, plane: .7, scope: .55 }[what], context = new Drawing(width, height, size);
  const dark = document.documentElement.classList.contains("dark");
  document.documentElement.classList.remove("dark"); readPalette();
  paper = { context, width, height, size };
  ({ stage: drawStage, plane: drawPlane, scope: drawScope })[what]();
  paper = null; document.documentElement.classList.toggle("dark", dark);
  readPalette(); drawStage(); drawPlane(); drawScope();
  const wall = view.walls[view.wall], about = view.hello.device + (wall ? `, ${unit(wall.stiffness, "N/m")}, ${unit(wall.damping, "N s/m")}, feed-forward ${NAMES[wall.feed_forward]}` : "");
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${millimetres}mm" height="${short(height * 25.4 / 96)}mm" viewBox="0 0 ${short(width)} ${short(height)}" font-family="Helvetica, Arial, sans-serif">\n` +
    `<title>${escapeXml(about)}</title>\n<defs>${context.defs.join("")}</defs>\n<rect width="100%" height="100%" fill="#fff"/>\n${context.out.join("\n")}\n</svg>\n`;
}
$("save").onchange = () => {
  const [what, millimetres] = $("save").value.split(" "), anchor = document.createElement("a");
  $("save").selectedIndex = 0; $("save").blur();
  if (!view.last || !view.hello) return;
  anchor.href = URL.createObjectURL(new Blob([svgOf(what, +millimetres)], { type: "image/svg+xml" }));
  anchor.download = `${view.hello.device}-${{ stage: "device", plane: "gains", scope: "scope" }[what]}-${millimetres}mm.svg`;
  anchor.click(); URL.revokeObjectURL(anchor.href);
  done(`Saved among the downloads: ${anchor.download}`);
};

theme(prefersDark.matches);
connect();
rereadLink();
