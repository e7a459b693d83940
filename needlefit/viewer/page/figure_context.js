/** A drawing context that records what the painters draw, and writes it as SVG or as PDF; px. */

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

// ---- SVG

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

// ---- PDF: its two fonts are in every reader, and have Latin letters and these

const GLYPHS = { "−": ["minus", 1], "μ": ["mu", 2] }; // names in Adobe's list, and their bytes
const POINTS = 72 / 25.4; // a mm

/** A text as bytes of WinAnsi; what the fonts lack is a question mark. */
const writeText = (text) => [...text].map((one) => (GLYPHS[one]?.[1] ?? (one.charCodeAt(0) < 256 ? one.charCodeAt(0) : 63)).toString(16).padStart(2, "0")).join("");
const setColour = (shade, name) => `${readColour(shade).parts.map((one) => round(one / 255)).join(" ")} ${name}`;

const PDF = {
  clip: ({ path }) => `q ${writeCurves(path)} W n`,
  restore: () => "Q",
  path: ({ path, fill, stroke, width, cap, join, dash, opacity }, shade) => [
    shade(fill ?? stroke, opacity), setColour(fill ?? stroke, fill ? "rg" : "RG"),
    stroke && `${width} w ${["butt", "round"].indexOf(cap)} J ${["miter", "round"].indexOf(join)} j [${dash.join(" ")}] 0 d`,
    writeCurves(path), fill ? "f" : "S",
  ].filter(Boolean).join(" "),
  text: ({ text, size, strong, fill, halo, matrix: { a, b, c, d, e, f }, opacity }, shade) => {
    const write = (mode) => `BT /F${strong ? 2 : 1} ${size} Tf ${mode} Tr ${[a, b, -c, -d, e, f].map(round).join(" ")} Tm <${writeText(text)}> Tj ET`;
    const behind = halo ? `${shade(halo.stroke, opacity)} ${setColour(halo.stroke, "RG")} ${halo.width} w 1 J 1 j [] 0 d ${write(1)} ` : "";
    return `${behind}${shade(fill, opacity)} ${setColour(fill, "rg")} ${write(0)}`;
  },
};
const writeCurves = (path) => path.map(([name, ...numbers]) => `${numbers.join(" ")} ${{ M: "m", L: "l", C: "c", Z: "h" }[name]}`).join(" ");

/** What was drawn on a size in px, as PDF of a width in mm: text is text. */
export function writePdf(drawn, [width, height], wide, title) {
  const scale = (wide * POINTS) / width;
  const states = new Map(); // opacities, each a state by its name
  const shade = (colour, opacity) => {
    const share = round(readColour(colour).opacity * opacity);
    if (!states.has(share)) states.set(share, `G${states.size}`);
    return `/${states.get(share)} gs`;
  };
  const content = drawn.map((one) => PDF[one.kind](one, shade)).join("\n");
  const placed = `${round(scale)} 0 0 ${round(-scale)} 0 ${round(scale * height)} cm\n${content}`;
  const differences = Object.values(GLYPHS).map(([name, code]) => `${code} /${name}`).join(" ");
  const font = (name) => `<< /Type /Font /Subtype /Type1 /BaseFont /${name} /Encoding << /BaseEncoding /WinAnsiEncoding /Differences [${differences}] >> >>`;
  const looks = [...states].map(([share, name]) => `/${name} << /ca ${share} /CA ${share} >>`).join(" ");
  const objects = [
    "<< /Type /Catalog /Pages 2 0 R >>",
    "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
    `<< /Type /Page /Parent 2 0 R /MediaBox [0 0 ${round(wide * POINTS)} ${round(scale * height)}] /Contents 4 0 R /Resources << /Font << /F1 ${font("Helvetica")} /F2 ${font("Helvetica-Bold")} >> /ExtGState << ${looks} >> >> >>`,
    `<< /Length ${placed.length} >>\nstream\n${placed}\nendstream`,
    `<< /Title <${writeText(title)}> >>`,
  ];
  let text = "%PDF-1.4\n";
  const places = objects.map((object, n) => {
    const at = text.length;
    text += `${n + 1} 0 obj\n${object}\nendobj\n`;
    return `${String(at).padStart(10, "0")} 00000 n \n`;
  });
  const count = objects.length + 1;
  return `${text}xref\n0 ${count}\n0000000000 65535 f \n${places.join("")}trailer\n<< /Size ${count} /Root 1 0 R /Info 5 0 R >>\nstartxref\n${text.length}\n%%EOF\n`;
}
