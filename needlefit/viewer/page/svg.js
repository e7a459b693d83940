/** A drawing context that writes SVG: of a canvas what the painters of the picture use. */

const NAMES = ["fillStyle", "strokeStyle", "lineWidth", "globalAlpha", "font", "textAlign", "textBaseline", "lineJoin", "lineCap"];
const SHIFT = { middle: 0.35, top: 0.8, bottom: -0.2, alphabetic: 0 }; // em from a baseline to the one of SVG
const ANCHOR = { left: "start", center: "middle", right: "end" };
const short = (value) => String(Math.round(value * 100) / 100);
const escaped = (text) => text.replace(/[&<>"]/g, (one) => `&#${one.charCodeAt(0)};`);

/** A colour and its opacity as attributes: SVG programs do not all know #rrggbbaa. */
function paint(kind, colour) {
  if (colour === "transparent") return `${kind}="none"`;
  const alpha = /^#\w{8}$/.test(colour) ? parseInt(colour.slice(7), 16) / 255 : 1;
  return `${kind}="${alpha < 1 ? colour.slice(0, 7) : colour}"${alpha < 1 ? ` ${kind}-opacity="${short(alpha)}"` : ""}`;
}

export class SvgContext {
  #parts = [];
  #clips = 0;
  #path = "";
  #halo = "";
  #kept = [];
  #state = { matrix: [1, 0, 0, 1, 0, 0], clip: "", dash: [] };
  #ruler = document.createElement("canvas").getContext("2d");

  constructor(width, height) {
    this.#parts.push(`<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}">`);
    Object.assign(this, { globalAlpha: 1, lineWidth: 1, lineJoin: "miter", lineCap: "butt", textAlign: "left", textBaseline: "alphabetic" });
  }

  /** The text of the file. */
  write() {
    return `${this.#parts.join("\n")}\n</svg>\n`;
  }

  save() {
    this.#kept.push({ ...this.#state, names: NAMES.map((name) => this[name]) });
  }
  restore() {
    const { names, ...state } = this.#kept.pop();
    this.#state = state;
    NAMES.forEach((name, i) => (this[name] = names[i]));
  }
  translate(x, y) {
    const [a, b, c, d, e, f] = this.#state.matrix;
    this.#state.matrix = [a, b, c, d, e + a * x + c * y, f + b * x + d * y];
  }
  rotate(angle) {
    const [[a, b, c, d, e, f], cos, sin] = [this.#state.matrix, Math.cos(angle), Math.sin(angle)];
    this.#state.matrix = [a * cos + c * sin, b * cos + d * sin, c * cos - a * sin, d * cos - b * sin, e, f];
  }
  setLineDash(dash) {
    this.#state.dash = dash;
  }

  beginPath() {
    this.#path = "";
  }
  moveTo(x, y) {
    this.#path += `M${short(x)} ${short(y)}`;
  }
  lineTo(x, y) {
    this.#path += `${this.#path ? "L" : "M"}${short(x)} ${short(y)}`;
  }
  closePath() {
    this.#path += "Z";
  }
  rect(x, y, width, height) {
    this.#path += `M${short(x)} ${short(y)}h${short(width)}v${short(height)}h${short(-width)}Z`;
  }
  roundRect(x, y, width, height) {
    this.rect(x, y, width, height);
  }
  /** Whole circles and ellipses only. */
  arc(x, y, radius) {
    this.ellipse(x, y, radius, radius);
  }
  ellipse(x, y, across, up) {
    const half = (way) => `a${short(across)} ${short(up)} 0 1 0 ${short(way * 2 * across)} 0`;
    this.#path += `M${short(x - across)} ${short(y)}${half(1)}${half(-1)}Z`;
  }
  clip() {
    this.#parts.push(`<clipPath id="clip${++this.#clips}"><path d="${this.#path}"/></clipPath>`);
    this.#state.clip = ` clip-path="url(#clip${this.#clips})"`;
  }

  #add(tag, attributes, content = "") {
    const { matrix, clip } = this.#state;
    const moved = matrix.every((one, i) => one === [1, 0, 0, 1, 0, 0][i]) ? "" : ` transform="matrix(${matrix.map((one) => Number(one.toFixed(4))).join(" ")})"`;
    const alpha = this.globalAlpha < 1 ? ` opacity="${this.globalAlpha}"` : "";
    const drawn = `<${tag} ${attributes}${moved}${alpha}${content ? `>${content}</${tag}>` : "/>"}`;
    this.#parts.push(clip ? `<g${clip}>${drawn}</g>` : drawn); // the clip is not moved with what it clips
  }
  #line() {
    const dash = this.#state.dash.length ? ` stroke-dasharray="${this.#state.dash.join(" ")}"` : "";
    return `${paint("stroke", this.strokeStyle)} stroke-width="${short(this.lineWidth)}" stroke-linejoin="${this.lineJoin}" stroke-linecap="${this.lineCap}"${dash}`;
  }
  fill() {
    if (this.fillStyle !== "transparent") this.#add("path", `d="${this.#path}" ${paint("fill", this.fillStyle)}`);
  }
  stroke() {
    this.#add("path", `d="${this.#path}" fill="none" ${this.#line()}`);
  }
  fillRect(...box) {
    this.beginPath();
    this.rect(...box);
    this.fill();
  }
  strokeRect(...box) {
    this.beginPath();
    this.rect(...box);
    this.stroke();
  }
  #text(text, x, y, painted) {
    const size = Number(/([\d.]+)px/.exec(this.font)[1]);
    const place = `x="${short(x)}" y="${short(y + SHIFT[this.textBaseline] * size)}" text-anchor="${ANCHOR[this.textAlign]}"`;
    this.#add("text", `${place} style="font:${this.font}" ${painted}`, escaped(text));
  }
  fillText(text, x, y) {
    this.#text(text, x, y, `${paint("fill", this.fillStyle)}${this.#halo}`);
    this.#halo = "";
  }
  /** The halo of the text that is filled next at the same place: one element has both. */
  strokeText() {
    this.#halo = ` ${this.#line()} paint-order="stroke"`;
  }
  measureText(text) {
    this.#ruler.font = this.font;
    return this.#ruler.measureText(text);
  }
  drawImage(image, x, y, width, height) {
    const copy = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
    copy.getContext("2d").drawImage(image, 0, 0);
    this.#add("image", `href="${copy.toDataURL()}" preserveAspectRatio="none" x="${short(x)}" y="${short(y)}" width="${short(width)}" height="${short(height)}"`);
  }
}
