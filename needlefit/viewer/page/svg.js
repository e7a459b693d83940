/** A drawing context that writes SVG: what the painters of the picture use of a canvas. */

const BASELINES = { alphabetic: 0, middle: 0.35, top: 0.8 }; // em that a text stands below its place
const escape = (text) => text.replace(/[&<>"]/g, (one) => `&#${one.charCodeAt(0)};`);
const round = (value) => Number(value.toFixed(3));

/** The attributes of a colour: `#rrggbb`, with an opacity, or `rgb(r g b)`. */
function paint(name, colour) {
  if (colour === "transparent") return `${name}="none"`;
  const [, hex, alpha] = colour.match(/^(#\w{6})(\w\w)?$/) ?? [];
  if (hex) return `${name}="${hex}"${alpha ? ` ${name}-opacity="${round(parseInt(alpha, 16) / 255)}"` : ""}`;
  const parts = colour.match(/[\d.]+/g) ?? [];
  return `${name}="#${parts.slice(0, 3).map((one) => Number(one).toString(16).padStart(2, "0")).join("")}"`;
}

export class SvgContext {
  fillStyle = "#000000"; strokeStyle = "#000000"; lineWidth = 1; globalAlpha = 1;
  lineCap = "butt"; lineJoin = "miter"; font = "12px sans-serif"; textAlign = "left"; textBaseline = "alphabetic";
  #parts = []; #path = []; #dash = []; #matrix = new DOMMatrix(); #stack = []; #clips = 0; #halo = "";
  #measure = document.createElement("canvas").getContext("2d");

  /** The drawing, of a size in px, at a width in mm. */
  write([width, height], wide, title, words) {
    const size = `width="${wide}mm" height="${round((wide * height) / width)}mm" viewBox="0 0 ${round(width)} ${round(height)}"`;
    return `<svg xmlns="http://www.w3.org/2000/svg" ${size} font-family="Liberation Sans, Arial, sans-serif">\n`
      + `<title>${escape(title)}</title>\n<desc>${escape(words)}</desc>\n${this.#parts.join("\n")}\n</svg>\n`;
  }

  #add(name, attributes, content = "") {
    const { a, b, c, d, e, f } = this.#matrix;
    const turned = this.#matrix.isIdentity ? "" : ` transform="matrix(${[a, b, c, d, e, f].map(round)})"`;
    const opacity = this.globalAlpha < 1 ? ` opacity="${round(this.globalAlpha)}"` : "";
    this.#parts.push(`<${name} ${attributes}${opacity}${turned}${content ? `>${content}</${name}>` : "/>"}`);
  }

  #line() {
    const dash = this.#dash.length ? ` stroke-dasharray="${this.#dash.join(" ")}"` : "";
    return `${paint("stroke", this.strokeStyle)} stroke-width="${this.lineWidth}" stroke-linecap="${this.lineCap}" stroke-linejoin="${this.lineJoin}"${dash}`;
  }

  save() {
    const { fillStyle, strokeStyle, lineWidth, globalAlpha, lineCap, lineJoin, font, textAlign, textBaseline } = this;
    this.#stack.push([{ fillStyle, strokeStyle, lineWidth, globalAlpha, lineCap, lineJoin, font, textAlign, textBaseline }, this.#matrix, this.#dash, 0]);
  }

  restore() {
    const [values, matrix, dash, clips] = this.#stack.pop();
    for (let n = 0; n < clips; n += 1) this.#parts.push("</g>");
    Object.assign(this, values);
    [this.#matrix, this.#dash] = [matrix, dash];
  }

  clip() {
    this.#clips += 1;
    this.#parts.push(`<clipPath id="clip-${this.#clips}"><path d="${this.#path.join("")}"/></clipPath>`, `<g clip-path="url(#clip-${this.#clips})">`);
    this.#stack.at(-1)[3] += 1;
  }

  translate(x, y) { this.#matrix = this.#matrix.translate(x, y); }
  rotate(angle) { this.#matrix = this.#matrix.rotate((angle * 180) / Math.PI); }
  setLineDash(dash) { this.#dash = dash; }
  beginPath() { this.#path = []; }
  moveTo(x, y) { this.#path.push(`M${round(x)} ${round(y)}`); }
  lineTo(x, y) { this.#path.push(`${this.#path.length ? "L" : "M"}${round(x)} ${round(y)}`); }
  closePath() { this.#path.push("Z"); }
  rect(x, y, width, height) { this.#path.push(`M${round(x)} ${round(y)}h${round(width)}v${round(height)}h${round(-width)}Z`); }
  arc(x, y, radius) { this.ellipse(x, y, radius, radius); }

  /** A whole ellipse along the axes: painters draw no part of one. */
  ellipse(x, y, along, across) {
    const half = (to) => `A${round(along)} ${round(across)} 0 0 1 ${round(x + to * along)} ${round(y)}`;
    this.#path.push(`M${round(x + along)} ${round(y)}${half(-1)}${half(1)}Z`);
  }

  roundRect(x, y, width, height, r) {
    const turn = (dx, dy) => `a${r} ${r} 0 0 1 ${dx} ${dy}`;
    this.#path.push(`M${round(x + r)} ${round(y)}h${round(width - 2 * r)}${turn(r, r)}v${round(height - 2 * r)}${turn(-r, r)}h${round(2 * r - width)}${turn(-r, -r)}v${round(2 * r - height)}${turn(r, -r)}Z`);
  }

  fill() { this.#add("path", `d="${this.#path.join("")}" ${paint("fill", this.fillStyle)}`); }
  stroke() { this.#add("path", `d="${this.#path.join("")}" fill="none" ${this.#line()}`); }
  fillRect(x, y, width, height) { this.#add("rect", `x="${round(x)}" y="${round(y)}" width="${round(width)}" height="${round(height)}" ${paint("fill", this.fillStyle)}`); }
  strokeRect(x, y, width, height) { this.#add("rect", `x="${round(x)}" y="${round(y)}" width="${round(width)}" height="${round(height)}" fill="none" ${this.#line()}`); }

  measureText(text) {
    this.#measure.font = this.font;
    return this.#measure.measureText(text);
  }

  /** The halo of the text that is written next. */
  strokeText() { this.#halo = ` ${paint("stroke", this.strokeStyle)} stroke-width="${this.lineWidth}" stroke-linejoin="round" paint-order="stroke"`; }

  fillText(text, x, y) {
    const [, weight = "", size] = this.font.match(/^(\d+ )?([\d.]+)px/);
    const anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
    const heavy = weight && ` font-weight="${weight.trim()}"`;
    const below = BASELINES[this.textBaseline] * Number(size);
    this.#add("text", `x="${round(x)}" y="${round(y)}" dy="${round(below)}" font-size="${size}"${heavy} text-anchor="${anchor}" ${paint("fill", this.fillStyle)}${this.#halo}`, escape(text));
    this.#halo = "";
  }
}
