/** A drawing context that records what the painters draw, and writes it as SVG; px. */

import { getContext } from "./dom.js";

const BASELINES = { alphabetic: 0, middle: 0.35, top: 0.8 }; // em that a text stands below its place
const ROUND = 0.5523; // of a quarter of a circle: its control points, in radii
const round = (value) => Number(value.toFixed(3));
const STYLE = ["fillStyle", "strokeStyle", "lineWidth", "globalAlpha", "lineCap", "lineJoin", "font", "textAlign", "textBaseline"];

export class FigureContext {
  fillStyle = "#000000"; strokeStyle = "#000000"; lineWidth = 1; globalAlpha = 1;
  lineCap = "butt"; lineJoin = "miter"; font = "12px sans-serif"; textAlign = "left"; textBaseline = "alphabetic";
  /** What was drawn, in order: {kind: path, text, clip or restore, and of each its numbers and looks}. */
  drawn = [];
  #path = []; #dash = []; #matrix = new DOMMatrix(); #stack = []; #clips = 0;
  /** @type {{stroke: string, width: number} | null} */
  #halo = null;
  #screen = getContext(document.createElement("canvas"));

  save() {
    this.#stack.push([Object.fromEntries(STYLE.map((name) => [name, this[name]])), this.#matrix, this.#clips]);
  }

  restore() {
    const [style, matrix, clips] = this.#stack.pop();
    for (; this.#clips > clips; this.#clips -= 1) this.drawn.push({ kind: "restore" });
    Object.assign(this, style);
    this.#matrix = matrix;
  }

  clip() {
    this.#clips += 1;
    this.drawn.push({ kind: "clip", path: this.#path });
  }

  translate(x, y) { this.#matrix = this.#matrix.translate(x, y); }
  rotate(angle) { this.#matrix = this.#matrix.rotate((angle * 180) / Math.PI); }
  setLineDash(dash) { this.#dash = dash; }
  beginPath() { this.#path = []; }
  closePath() { this.#path.push(["Z"]); }
  moveTo(x, y) { this.#add("M", [x, y]); }
  lineTo(x, y) { this.#add("L", [x, y]); }

  rect(x, y, width, height) {
    this.moveTo(x, y);
    for (const corner of [[x + width, y], [x + width, y + height], [x, y + height]]) this.#add("L", corner);
    this.closePath();
  }

  /** A whole circle: painters draw no part of one. */
  arc(x, y, radius) {
    this.moveTo(x + radius, y);
    for (const [ax, ay, bx, by] of [[1, 0, 0, 1], [0, 1, -1, 0], [-1, 0, 0, -1], [0, -1, 1, 0]]) {
      const at = (px, py) => [x + radius * px, y + radius * py];
      this.#add("C", at(ax + ROUND * bx, ay + ROUND * by), at(bx + ROUND * ax, by + ROUND * ay), at(bx, by));
    }
    this.closePath();
  }

  #add(name, ...points) {
    const moved = points.map(([x, y]) => this.#matrix.transformPoint({ x, y }));
    this.#path.push([name, ...moved.flatMap(({ x, y }) => [round(x), round(y)])]);
  }

  fill() { this.#draw({ fill: this.fillStyle }); }
  stroke() { this.#draw({ stroke: this.strokeStyle, width: this.lineWidth, cap: this.lineCap, join: this.lineJoin, dash: this.#dash }); }
  #draw(looks) { this.drawn.push({ kind: "path", path: this.#path, opacity: this.globalAlpha, ...looks }); }

  fillRect(x, y, width, height) {
    this.beginPath();
    this.rect(x, y, width, height);
    this.fill();
  }

  strokeRect(x, y, width, height) {
    this.beginPath();
    this.rect(x, y, width, height);
    this.stroke();
  }

  measureText(text) {
    this.#screen.font = this.font;
    return this.#screen.measureText(text);
  }

  /** The halo of the text that is written next. */
  strokeText() { this.#halo = { stroke: this.strokeStyle, width: this.lineWidth }; }

  fillText(text, x, y) {
    const [, weight, size] = this.font.match(/^(\d+ )?([\d.]+)px/) ?? ["", "", "12"];
    const share = { left: 0, center: 0.5, right: 1 }[this.textAlign];
    const place = [x - share * this.measureText(text).width, y + BASELINES[this.textBaseline] * Number(size)];
    this.drawn.push({ kind: "text", text, size: Number(size), strong: Boolean(weight), fill: this.fillStyle, halo: this.#halo,
      matrix: this.#matrix.translate(...place), opacity: this.globalAlpha });
    this.#halo = null;
  }
}

/** A colour, `#rrggbb` with an opacity or `rgb(r, g, b)`, as {parts: of 255, opacity}. */
function readColour(shade) {
  const hex = shade.match(/^#(\w\w)(\w\w)(\w\w)(\w\w)?$/)?.slice(1).map((one) => parseInt(one ?? "ff", 16));
  const [red, green, blue, alpha = 255] = hex ?? shade.match(/[\d.]+/g).map(Number);
  return { parts: [red, green, blue], opacity: alpha / 255 };
}

const writePath = (path) => path.map(([name, ...numbers]) => name + numbers.join(" ")).join("");

const escape = (text) => text.replace(/[&<>"]/g, (one) => `&#${one.charCodeAt(0)};`);

function writePaint(name, shade, opacity = 1) {
  if (!shade) return `${name}="none"`;
  const { parts, opacity: own } = readColour(shade);
  const share = round(own * opacity);
  return `${name}="#${parts.map((one) => one.toString(16).padStart(2, "0")).join("")}"${share < 1 ? ` ${name}-opacity="${share}"` : ""}`;
}

const writeLine = ({ stroke, width, cap = "round", join = "round", dash = [] }, opacity) =>
  `${writePaint("stroke", stroke, opacity)} stroke-width="${width}" stroke-linecap="${cap}" stroke-linejoin="${join}"${dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : ""}`;

const SVG = {
  clip: ({ path }, n) => `<clipPath id="clip-${n}"><path d="${writePath(path)}"/></clipPath><g clip-path="url(#clip-${n})">`,
  restore: () => "</g>",
  path: (one) => `<path d="${writePath(one.path)}" ${writePaint("fill", one.fill, one.opacity)}${one.stroke ? ` ${writeLine(one, one.opacity)}` : ""}/>`,
  text: ({ text, size, strong, fill, halo, matrix: { a, b, c, d, e, f }, opacity }) => {
    const place = b || c ? `transform="matrix(${[a, b, c, d, e, f].map(round).join(" ")})"` : `x="${round(e)}" y="${round(f)}"`;
    const behind = halo ? ` ${writeLine(halo, opacity)} paint-order="stroke"` : "";
    return `<text ${place} font-size="${size}"${strong ? ' font-weight="600"' : ""} ${writePaint("fill", fill, opacity)}${behind}>${escape(text)}</text>`;
  },
};

/** What was drawn on a size in px, as SVG of a width in mm. */
export function writeSvg(drawn, [width, height], wide, title, words) {
  const size = `width="${wide}mm" height="${round((wide * height) / width)}mm" viewBox="0 0 ${round(width)} ${round(height)}"`;
  return `<svg xmlns="http://www.w3.org/2000/svg" ${size} font-family="Arial, Liberation Sans, Helvetica, sans-serif">\n`
    + `<title>${escape(title)}</title>\n<desc>${escape(words)}</desc>\n${drawn.map((one, n) => SVG[one.kind](one, n)).join("\n")}\n</svg>\n`;
}
