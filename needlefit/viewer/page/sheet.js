/** What the painters draw on, by paths as SVG writes them, px: the screen, or a figure. */

import { rgb } from "d3-color";
import { line } from "d3-shape";
import { getContext } from "./dom.js";

const FAMILY = "Arial, Liberation Sans, Helvetica, sans-serif"; // of one width everywhere, also in a saved figure
const SVG = "http://www.w3.org/2000/svg";
const HALO = 4; // px
const MIDDLE = 0.35; // em, from the middle of a text down to its base line

/** Weight and size, px. @type {Record<Font, [number, number]>} */
const FONTS = { small: [400, 11], plain: [400, 12], strong: [600, 12] };
/** @param {Font} font */
const writeFont = (font) => `${FONTS[font][0]} ${FONTS[font][1]}px ${FAMILY}`;

const ruler = getContext(document.createElement("canvas"));

/** The width of a text, px. @param {string} words @param {Font} font */
export function measure(words, font) {
  ruler.font = writeFont(font);
  return ruler.measureText(words).width;
}

/** The path of a line through places. @type {(places: Point[]) => string} */
export const trace = (places) => line()(places) ?? "";

/** @param {Box} box */
export const traceBox = ({ left, top, width, height }) =>
  `${trace([[left, top], [left + width, top], [left + width, top + height], [left, top + height]])}Z`;

/** The canvas of a context. @implements {Sheet} */
export class Screen {
  /** @param {CanvasRenderingContext2D} context */
  constructor(context) {
    this.context = context;
    Object.assign(context, { lineJoin: "round" });
  }

  /** @param {string} d @param {Looks} looks */
  path(d, { fill, stroke, width = 1, dash = [], opacity = 1 }) {
    const { context } = this;
    const path = new Path2D(d);
    Object.assign(context, { globalAlpha: opacity, fillStyle: fill, strokeStyle: stroke, lineWidth: width });
    context.setLineDash(dash);
    if (fill) context.fill(path);
    if (stroke) context.stroke(path);
  }

  /** @param {string} words @param {Point} place @param {TextLooks} looks */
  text(words, [x, y], { fill, font = "small", align = "center", halo }) {
    const { context } = this;
    Object.assign(context, { globalAlpha: 1, font: writeFont(font), textAlign: align, fillStyle: fill, strokeStyle: halo, lineWidth: HALO });
    context.setLineDash([]);
    const base = y + MIDDLE * FONTS[font][1];
    if (halo) context.strokeText(words, x, base);
    context.fillText(words, x, base);
  }

  /** @param {() => void} draw */
  #apart(draw) {
    this.context.save();
    draw();
    this.context.restore();
  }

  /** @param {Box} box @param {() => void} draw */
  within(box, draw) {
    this.#apart(() => {
      this.context.clip(new Path2D(traceBox(box)));
      draw();
    });
  }

  /** @param {Point} place @param {number} angle @param {() => void} draw */
  turned([x, y], angle, draw) {
    this.#apart(() => {
      this.context.translate(x, y);
      this.context.rotate(-angle);
      draw();
    });
  }
}

/** An element of SVG. @param {string} name @param {Record<string, string | number | undefined>} attributes */
function make(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) if (value !== undefined) made.setAttribute(key, String(value));
  return made;
}

/** How an area or a line is painted: its opacity is an attribute of its own. @param {string} name @param {string | undefined} shade */
function paint(name, shade, opacity = 1) {
  const { opacity: own } = rgb(shade ?? "#000");
  const share = own * opacity;
  return { [name]: shade ? rgb(shade).formatHex() : "none", [`${name}-opacity`]: share < 1 ? share.toFixed(2) : undefined };
}

/** An SVG of a size, px, and of a width in mm. @implements {Sheet} */
export class Figure {
  #clips = 0;

  /** @param {Point} size @param {number} wide @param {string} title @param {string} words */
  constructor([width, height], wide, title, words) {
    this.svg = this.group = make("svg", {
      width: `${wide}mm`, height: `${((wide * height) / width).toFixed(2)}mm`, viewBox: `0 0 ${width.toFixed(2)} ${height.toFixed(2)}`,
      "font-family": FAMILY, "stroke-linejoin": "round",
    });
    this.#add("title", {}).textContent = title;
    this.#add("desc", {}).textContent = words;
  }

  /** @param {string} name @param {Record<string, string | number | undefined>} attributes */
  #add(name, attributes) {
    const made = make(name, attributes);
    this.group.append(made);
    return made;
  }

  /** @param {string} d @param {Looks} looks */
  path(d, { fill, stroke, width = 1, dash = [], opacity = 1 }) {
    this.#add("path", {
      d, ...paint("fill", fill, opacity), ...(stroke && { ...paint("stroke", stroke, opacity), "stroke-width": width }),
      "stroke-dasharray": dash.join(" ") || undefined,
    });
  }

  /** @param {string} words @param {Point} place @param {TextLooks} looks */
  text(words, [x, y], { fill, font = "small", align = "center", halo }) {
    const [weight, size] = FONTS[font];
    this.#add("text", {
      x: x.toFixed(2), y: (y + MIDDLE * size).toFixed(2), "font-size": size, "font-weight": weight, "text-anchor": align.replace("center", "middle"),
      ...paint("fill", fill), ...(halo && { ...paint("stroke", halo), "stroke-width": HALO, "paint-order": "stroke" }),
    }).textContent = words;
  }

  /** @param {Record<string, string>} attributes @param {() => void} draw */
  #apart(attributes, draw) {
    const outer = this.group;
    this.group = this.#add("g", attributes);
    draw();
    this.group = outer;
  }

  /** @param {Box} box @param {() => void} draw */
  within(box, draw) {
    this.#clips += 1;
    const id = `clip-${this.#clips}`;
    this.#add("clipPath", { id }).append(make("path", { d: traceBox(box) }));
    this.#apart({ "clip-path": `url(#${id})` }, draw);
  }

  /** @param {Point} place @param {number} angle @param {() => void} draw */
  turned([x, y], angle, draw) {
    this.#apart({ transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${((-angle * 180) / Math.PI).toFixed(2)})` }, draw);
  }
}
