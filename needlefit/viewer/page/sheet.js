/** What the painters draw on: an SVG, px. Paths as SVG writes them, texts by their middles, colours by their names in the style. */

import { line } from "d3-shape";

const FAMILY = "Arial, Liberation Sans, Helvetica, sans-serif"; // of one width everywhere, also in a saved figure
const SVG = "http://www.w3.org/2000/svg";
const HALO = 4; // px
const MIDDLE = 0.35; // em, from the middle of a text down to its base line

/** Weight and size, px. @type {Record<Font, [number, number]>} */
const FONTS = { small: [400, 11], plain: [400, 12], strong: [600, 12] };
const ruler = /** @type {CanvasRenderingContext2D} */ (document.createElement("canvas").getContext("2d"));
let group = /** @type {ParentNode} */ (document.createDocumentFragment()); // that is drawn into
let clips = 0;

/** The width of a text, px. @param {string} words @param {Font} font */
export function measure(words, font) {
  ruler.font = `${FONTS[font].join(" ")}px ${FAMILY}`;
  return ruler.measureText(words).width;
}

/** The path of a line through places. @type {(places: Point[]) => string} */
export const trace = (places) => line()(places) ?? "";

/** @param {Box} box */
export const traceBox = ({ left, top, width, height }) => `M${left},${top}h${width}v${height}h${-width}Z`;

/** Make an element of SVG. @param {string} name @param {Record<string, string | number | undefined>} attributes */
function make(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const key in attributes) if (attributes[key] !== undefined) made.setAttribute(key, String(attributes[key]));
  return made;
}

/** Add an element to what is drawn into. @param {string} name @param {Record<string, string | number | undefined>} attributes */
function add(name, attributes) {
  const made = make(name, attributes);
  group.append(made);
  return made;
}

/** @param {ParentNode} inner @param {() => void} draw */
function into(inner, draw) {
  const outer = group;
  group = inner;
  draw();
  group = outer;
}

/** Draw anew on an SVG of a size, px. @param {Element} svg @param {Point} size @param {() => void} draw */
export function drawOn(svg, [width, height], draw) {
  const drawn = document.createDocumentFragment();
  into(drawn, draw);
  svg.setAttribute("viewBox", `0 0 ${width.toFixed(2)} ${height.toFixed(2)}`);
  svg.replaceChildren(drawn);
}

/** An SVG for print, of a width in mm, with a title and a description; colours are those that `read` gives. @param {Point} size @param {number} wide @param {string[]} words @param {(name: string) => string} read @param {() => void} draw */
export function writeFigure(size, wide, [title, description], read, draw) {
  const svg = make("svg", { width: `${wide}mm`, height: `${((wide * size[1]) / size[0]).toFixed(2)}mm` });
  drawOn(svg, size, () => {
    add("title", {}).textContent = title;
    add("desc", {}).textContent = description;
    draw();
  });
  return new XMLSerializer().serializeToString(svg).replace(/var\(--(\w+)\)/g, (_, name) => read(name));
}

/** @param {string | undefined} name */
const shade = (name) => name && `var(--${name})`;

/** @param {string} d @param {Looks} looks */
export const path = (d, { fill, stroke, width = 1, dash, opacity }) => add("path", {
  d, opacity, fill: shade(fill) ?? "none", stroke: shade(stroke), "stroke-width": stroke && width, "stroke-linejoin": stroke && "round",
  "stroke-dasharray": dash?.join(" "),
});

/** @param {string} words @param {Point} place @param {TextLooks} [looks] */
export function text(words, [x, y], { fill = "label", font = "small", align = "middle", halo } = {}) {
  const [weight, size] = FONTS[font];
  add("text", {
    x: x.toFixed(2), y: (y + MIDDLE * size).toFixed(2), "font-family": FAMILY, "font-size": size, "font-weight": weight, "text-anchor": align,
    fill: shade(fill), ...(halo && { stroke: shade("halo"), "stroke-width": HALO, "stroke-linejoin": "round", "paint-order": "stroke" }),
  }).textContent = words;
}

/** Draw what lies in a box. @param {Box} box @param {() => void} draw */
export function within(box, draw) {
  const id = `clip-${(clips += 1)}`;
  add("clipPath", { id }).append(make("path", { d: traceBox(box) }));
  into(add("g", { "clip-path": `url(#${id})` }), draw);
}

/** Draw about a place, turned counterclockwise by an angle, rad. @param {Point} place @param {number} angle @param {() => void} draw */
export const turned = ([x, y], angle, draw) =>
  into(add("g", { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${((-angle * 180) / Math.PI).toFixed(2)})` }), draw);
