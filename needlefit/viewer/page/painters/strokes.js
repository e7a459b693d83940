/** Lines, shapes and labels of the picture, given in mm or px. */

import { least } from "d3-array";
import { area } from "d3-shape";
import { measure, path, text, trace } from "../sheet.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";

/** Draw lines through places (px). @param {Point[][]} lines @param {string} stroke @param {number} width @param {number[]} [dash] */
export const polyline = (lines, stroke, width, dash) => path(lines.map(trace).join(""), { stroke, width, dash });

/** Fill a shape between corners (px). @param {Point[]} corners @param {string} fill @param {number} [opacity] */
export const polygon = (corners, fill, opacity) => path(`${trace(corners)}Z`, { fill, opacity });

/** The places (px) of points (mm). @param {Pick<Curve, "x" | "y">} curve @returns {Point[]} */
export const placesOf = ({ x, y }) => x.map((one, i) => [toPx(one), toPy(y[i])]);

/** Draw a line along points (mm) over a halo that sets it off from what lies behind. @param {Curve} curve @param {string} shade @param {number} width @param {number[]} [dash] */
export function haloed(curve, shade, width, dash) {
  const places = [placesOf(curve)];
  polyline(places, "halo", width + 2);
  polyline(places, shade, width, dash);
}

/** The path of what lies between two curves over the same x (mm). @param {number[]} x @param {number[]} low @param {number[]} high */
export const traceBetween = (x, low, high) =>
  /** @type {import("d3-shape").Area<number>} */ (area()).x((_, i) => toPx(x[i])).y0((_, i) => toPy(low[i])).y1((_, i) => toPy(high[i]))(x) ?? "";

/** The two lines of a cross about a place (px), upright or oblique. @type {(place: Point, arm: number, oblique?: boolean) => Point[][]} */
export const cross = ([px, py], arm, oblique = false) => [[arm, oblique ? arm : 0], [oblique ? -arm : 0, arm]]
  .map(([dx, dy]) => [[px - dx, py - dy], [px + dx, py + dy]]);

/** The path of an ellipse about a place (px). @type {(place: Point, along: number, across: number) => string} */
export const traceEllipse = ([px, py], along, across) =>
  `M${px - along},${py}a${along},${across} 0 1 0 ${2 * along},0a${along},${across} 0 1 0 ${-2 * along},0Z`;

// ---- labels that do not overlap: what is written in this frame, and what else no label may lie on, px

const LINE = 16; // px, height of a label
const SHARES = [1, 0.8, 0.6, 0.4]; // of a curve, where its label may stand

export const clearLabels = () => Object.assign(now, { labels: [], avoided: [] });
/** @param {Place} one @param {Place} other */
const overlap = ([x, y, w, h], [x2, y2, w2, h2]) => x < x2 + w2 && x2 < x + w && y < y2 + h2 && y2 < y + h;
/** How many of these lie there. @param {Place[]} places @param {Place} box */
const count = (places, box) => places.filter((one) => overlap(one, box)).length;
/** How many labels and parts of curves lie there. @param {Place} box */
export const countBelow = (box) => count([...now.labels, ...now.avoided], box);

/** Keep labels off a line (px) where there is room for them elsewhere. @param {Point[]} places */
export function avoid(places) {
  for (const [px, py] of places) {
    const [left, top] = now.avoided.at(-1) ?? [-Infinity, 0];
    if (Math.hypot(px - 4 - left, py - 4 - top) > 8) now.avoided.push([px - 4, py - 4, 8, 8]);
  }
}

/** Write a label at the free place (px, its middle) where it covers least, inside the window; else nowhere. @param {string} words @param {Point[]} places @param {string} fill */
export function labelFree(words, places, fill) {
  const { left, top, width, height } = view.box;
  const wide = measure(words, "strong") + 6;
  /** @param {number} value @param {number} low @param {number} high */
  const limit = (value, low, high) => Math.max(low, Math.min(value, high));
  const free = places.map(([px, py]) => /** @type {Place} */ (
    [limit(px - wide / 2, left + 2, left + width - wide - 2), limit(py - LINE / 2, top + 2, top + height - LINE - 2), wide, LINE])).filter((one) => !count(now.labels, one));
  const box = least(free, (one) => count(now.avoided, one));
  if (!box) return;
  now.labels.push(box);
  text(words, [box[0] + wide / 2, box[1] + LINE / 2], { fill, font: "strong", halo: true });
}

/** Write a label at the end of curves (mm), or beside them: each with how far below it (px), above if negative. @param {string} words @param {[Curve, number][]} sides @param {string} shade */
export function labelBeside(words, sides, shade) {
  const half = measure(words, "strong") / 2;
  const curves = sides.map(([curve, away]) => ({ places: placesOf(curve), away }));
  for (const { places } of curves) avoid(places);
  const ends = curves.map(({ places }) => places[places.length - 1]).map(([px, py]) => /** @type {Point} */ ([px + half + 8, py]));
  const beside = SHARES.flatMap((share) => curves.flatMap(({ places, away }) => {
    const [px, py] = places[Math.round(share * (places.length - 1))];
    return [0, -half, half].map((aside) => /** @type {Point} */ ([px + aside, py + away]));
  }));
  labelFree(words, [...ends, ...beside], shade);
}

/** Name a line at its end. @param {string} words @param {Curve} curve @param {string} shade */
export const nameLine = (words, curve, shade) => labelBeside(words, [[curve, 16], [curve, -16]], shade);
