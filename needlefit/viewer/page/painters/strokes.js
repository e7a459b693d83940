/** Colours, lines, shapes and labels on the canvas, given in mm or px. */

import { area, line as makeLine } from "d3-shape";
import { interpolateRgb } from "d3-interpolate";
import { colour } from "../dom.js";
import { now } from "../store.js";
import { toPx, toPy } from "../view.js";

const NAMES = [
  "air", "gutter", "ink", "quiet", "edge", "needle", "tip", "guide",
  "measured", "band", "plan", "gap", "bad", "halo", "soft", "stiff", "label", "accent",
];
const FAMILY = "Arial, 'Liberation Sans', Helvetica, sans-serif"; // of one width everywhere, also in a saved figure
const FONTS = { small: `11px ${FAMILY}`, plain: `12px ${FAMILY}`, strong: `600 12px ${FAMILY}` };

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
  return stiffness.map((one) => interpolateRgb(palette.soft, palette.stiff)((one - least) / decades));
}

/** Draw what lies within a box, px. */
export function within(context, { left, top, width, height }, draw) {
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  draw();
  context.restore();
}

export function faintly(context, opacity, draw) {
  context.globalAlpha = opacity;
  draw();
  context.globalAlpha = 1;
}

/** Draw the current path as a line. */
function stroke(context, shade, width, dash = []) {
  context.strokeStyle = shade;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.stroke();
  context.setLineDash([]);
}

/** Draw lines through places (px). */
export function polyline(context, lines, shade, width, dash = []) {
  context.beginPath();
  for (const places of lines) makeLine().context(context)(places);
  stroke(context, shade, width, dash);
}

/** Fill a shape between corners (px). */
export function polygon(context, corners, shade) {
  context.beginPath();
  makeLine().context(context)(corners);
  context.fillStyle = shade;
  context.fill();
}

/** The places (px) of points (mm). */
export const placesOf = (x, y) => x.map((one, i) => [toPx(one), toPy(y[i])]);

/** Draw a line along points (mm). */
export const line = (context, x, y, shade, width, dash = []) => polyline(context, [placesOf(x, y)], shade, width, dash);

/** Draw a line along points (mm) over a halo that sets it off from what lies behind. */
export function haloed(context, { x, y }, shade, width, dash = []) {
  line(context, x, y, palette.halo, width + 2);
  line(context, x, y, shade, width, dash);
}

/** Fill what lies between two curves over the same x (mm). */
export function fillBetween(context, x, low, high, shade) {
  context.beginPath();
  area().x((_, i) => toPx(x[i])).y0((_, i) => toPy(low[i])).y1((_, i) => toPy(high[i])).context(context)(x);
  context.fillStyle = shade;
  context.fill();
}

/** The two lines of a cross about a place (px). */
export const cross = (px, py, arm) => [[arm, 0], [0, arm]].map(([dx, dy]) => [[px - dx, py - dy], [px + dx, py + dy]]);

/** Draw a ring with a filled inside. */
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
export function label(context, text, px, py, shade = palette.label) {
  context.strokeStyle = palette.halo;
  context.lineWidth = 4;
  context.strokeText(text, px, py);
  context.fillStyle = shade;
  context.fillText(text, px, py);
}

// ---- labels that do not overlap: what is written in this frame, and what else no label may lie on, px: [left, top, width, height]

const LINE = 16; // px, height of a label
const SHARES = [1, 0.8, 0.6, 0.4]; // of a curve, where its label may stand

export const clearLabels = () => Object.assign(now, { labels: [], avoided: [] });
const overlap = ([x, y, w, h], [x2, y2, w2, h2]) => x < x2 + w2 && x2 < x + w && y < y2 + h2 && y2 < y + h;
/** @param {import("../types").Place} box */
const isFree = (box) => !now.labels.some((one) => overlap(one, box));

/** Keep labels off a line (px) where there is room for them elsewhere. */
export function avoid(places) {
  for (const [px, py] of places) {
    const [left, top] = now.avoided.at(-1) ?? [-Infinity, 0];
    if (Math.hypot(px - 4 - left, py - 4 - top) > 8) now.avoided.push([px - 4, py - 4, 8, 8]);
  }
}

/** Write a label at the first of some places (px, its middle) that is free, inside the window; else nowhere. */
export function labelFree(context, text, places, shade) {
  const { left, top, width, height } = now.view.box;
  const wide = context.measureText(text).width + 6;
  const limit = (value, low, high) => Math.max(low, Math.min(value, high));
  const free = places.map(([px, py]) => /** @type {import("../types").Place} */ (
    [limit(px - wide / 2, left + 2, left + width - wide - 2), limit(py - LINE / 2, top + 2, top + height - LINE - 2), wide, LINE])).filter(isFree);
  const box = free.find((one) => !now.avoided.some((other) => overlap(one, other))) ?? free[0];
  if (!box) return;
  now.labels.push(box);
  context.textAlign = "center";
  context.textBaseline = "middle";
  label(context, text, box[0] + wide / 2, box[1] + LINE / 2, shade);
}

/** Write a label at the end of curves {x, y} (mm), or beside them: each with how far below it (px), above if negative. */
export function labelBeside(context, text, sides, shade) {
  setFont(context, "strong");
  const half = context.measureText(text).width / 2;
  const curves = sides.map(([{ x, y }, away]) => [placesOf(x, y), away]);
  for (const [places] of curves) avoid(places);
  const ends = curves.map(([places]) => [places.at(-1)[0] + half + 8, places.at(-1)[1]]); 
  const beside = SHARES.flatMap((share) => curves.flatMap(([places, away]) => {
    const [px, py] = places[Math.round(share * (places.length - 1))];
    return [0, -half, half].map((aside) => [px + aside, py + away]);
  }));
  labelFree(context, text, [...ends, ...beside], shade);
}
