/** Colours, lines and shapes on the canvas, given in mm or px. */

import { colour } from "../dom.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";

const NAMES = [
  "air", "gutter", "ink", "quiet", "edge", "needle", "points", "path", "tip", "guide", "load",
  "measured", "band", "ghost", "plan", "gap", "bad", "halo", "soft", "stiff", "label", "accent",
];
const FONTS = { small: "11px system-ui, sans-serif", plain: "12px system-ui, sans-serif", strong: "600 12px system-ui, sans-serif" };

/** Colours by name, as the style sheet has them for light and for dark; read anew when the reader's scheme changes. */
export const palette = {};

export function readPalette() {
  for (const name of NAMES) palette[name] = colour(name);
}

/** One colour a layer: the stiffer, the darker, over one decade at least. */
export function shades(layers) {
  const stiffness = layers.map(({ mu_pa: mu }) => Math.log10(mu));
  const least = Math.min(...stiffness);
  const decades = Math.max(Math.max(...stiffness) - least, 1);
  return stiffness.map((one) => between(palette.soft, palette.stiff, (one - least) / decades));
}

/** A colour between two, given as #rrggbb. */
export function between(one, other, share) {
  const parts = [1, 3, 5].map((at) => {
    const [low, high] = [one, other].map((colour) => parseInt(colour.slice(at, at + 2), 16));
    return Math.round(low + share * (high - low));
  });
  return `rgb(${parts.join(" ")})`;
}

export function faintly(context, opacity, draw) {
  context.globalAlpha = opacity;
  draw();
  context.globalAlpha = 1;
}

/** Draw the current path as a line. */
export function stroke(context, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}

/** Make the current path from lines through places (px). */
export function trace(context, ...lines) {
  context.beginPath();
  for (const places of lines) places.forEach(([px, py], i) => (i ? context.lineTo(px, py) : context.moveTo(px, py)));
}

/** Draw an arrow, which always means a force: from a place (px) along y by so many px, up if positive. */
export function arrow(context, [px, py], length, colour) {
  const [end, head] = [py - length, 8 * Math.sign(length)];
  segments(context, [[[px, py], [px, end + head]]], colour, 2.5);
  polygon(context, [[px - 5, end + head], [px, end], [px + 5, end + head]], colour);
}

/** The places (px) of points (mm). */
export const placesOf = (x, y) => x.map((one, i) => [toPx(one), toPy(y[i])]);

/** Draw a line along points (mm). */
export function line(context, x, y, colour, width, dash = []) {
  context.setLineDash(dash);
  trace(context, placesOf(x, y));
  stroke(context, colour, width);
  context.setLineDash([]);
}

/** Fill what lies between two curves over the same x (mm). */
export function fillBetween(context, x, low, high, colour) {
  trace(context, [...placesOf(x, low), ...placesOf(x, high).reverse()]);
  context.closePath();
  context.fillStyle = colour;
  context.fill();
}

export function polygon(context, corners, colour) {
  context.fillStyle = colour;
  context.beginPath();
  for (const corner of corners) context.lineTo(...corner);
  context.fill();
}

/** Draw straight lines between pairs of places (px). */
export function segments(context, pairs, colour, width) {
  context.beginPath();
  for (const [from, to] of pairs) {
    context.moveTo(...from);
    context.lineTo(...to);
  }
  stroke(context, colour, width);
}

/** The two lines of a cross about a place (px), upright or oblique. */
export const cross = (px, py, arm, oblique = false) => (oblique ? [[arm, arm], [arm, -arm]] : [[arm, 0], [0, arm]])
  .map(([dx, dy]) => [[px - dx, py - dy], [px + dx, py + dy]]);

/** Draw a ring with a filled inside, as handles have it. */
export function ring(context, px, py, radius, edge, inside) {
  context.beginPath();
  context.arc(px, py, radius, 0, 2 * Math.PI);
  context.fillStyle = inside;
  context.fill();
  stroke(context, edge, 2);
}

/** Carry out drawing with the origin at a place in px, x along a direction (rad, counterclockwise). */
export function turned(context, px, py, angle, draw) {
  context.save();
  context.translate(px, py);
  context.rotate(-angle);
  draw();
  context.restore();
}

export function setFont(context, font, align = "center", baseline = "middle") {
  context.font = FONTS[font];
  context.textAlign = align;
  context.textBaseline = baseline;
}

/** Write on the picture, set off from what lies behind. */
export function label(context, text, px, py, colour = palette.label) {
  context.strokeStyle = palette.halo;
  context.lineWidth = 4;
  context.strokeText(text, px, py);
  context.fillStyle = colour;
  context.fillText(text, px, py);
}

const LINE = 16; // px, height of a label
let [boxes, avoided] = [[], []]; // what is written in this frame, and what else no label may lie on, px: [left, top, width, height]

export function clearBoxes() {
  [boxes, avoided] = [[], []];
  now.labels = boxes;
}
const overlap = ([x, y, w, h], [x2, y2, w2, h2]) => x < x2 + w2 && x2 < x + w && y < y2 + h2 && y2 < y + h;
export const isFree = (box) => !boxes.some((one) => overlap(one, box));
export const reserve = (...box) => boxes.push(box);

/** Keep labels off a line (px) where there is room for them elsewhere. */
export function avoid(places) {
  for (const [px, py] of places) {
    const [left, top] = avoided.at(-1) ?? [-Infinity, 0];
    if (Math.hypot(px - 4 - left, py - 4 - top) > 8) avoided.push([px - 4, py - 4, 8, 8]);
  }
}

/** Write a label at the first of some places (px, its middle) that is free, inside the window; else nowhere. */
export function labelFree(context, text, places, colour) {
  const { left, top, width, height } = view.box;
  const wide = context.measureText(text).width + 6;
  const within = (value, low, high) => Math.max(low, Math.min(value, high));
  const free = places.map(([px, py]) =>
    [within(px - wide / 2, left + 2, left + width - wide - 2), within(py - LINE / 2, top + 2, top + height - LINE - 2), wide, LINE]).filter(isFree);
  const box = free.find((one) => !avoided.some((other) => overlap(one, other))) ?? free[0];
  if (!box) return;
  boxes.push(box);
  context.textAlign = "center";
  context.textBaseline = "middle";
  label(context, text, box[0] + wide / 2, box[1] + LINE / 2, colour);
}

const SHARES = [1, 0.8, 0.6, 0.4]; // of a curve, where its label may stand

/** Write a label beside curves: pairs of points [x, y] (mm), and how far below them (px), above if negative. */
export function labelBeside(context, text, sides, colour) {
  setFont(context, "strong");
  const half = context.measureText(text).width / 2;
  const curves = sides.map(([points, away]) => [placesOf(...points), away]);
  for (const [places] of curves) avoid(places);
  const beside = SHARES.flatMap((share) => curves.flatMap(([places, away]) => {
    const [px, py] = places[Math.round(share * (places.length - 1))];
    return [0, -half, half].map((aside) => [px + aside, py + away]);
  }));
  labelFree(context, text, beside, colour);
}
