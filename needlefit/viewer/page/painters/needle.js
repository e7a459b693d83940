/** The needle, what holds it, and what the tissue puts on its shaft. */

import { max, nice } from "d3-array";
import { describeLoad } from "../model/state.js";
import { brief, shortName } from "../quantities.js";
import { measure } from "../sheet.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { avoid, cross, label, labelFree, nameLine, palette, placesOf, polygon, polyline } from "./strokes.js";

const LINE = 2.5; // px, of the needle
const BEVEL = { length: 7.5, half: 1.5 }; // px
const GAP = 3; // px between the axis of the needle and a guide
const CROSS = { of: 0.28, least: 1, most: 3.2 }; // half a cross: part of the spacing, px
const TALLEST = 36; // px, of the load's curve and of its scale, which stand above window and needle

/** The direction in the picture of a slope. @param {number} slope */
const angleOf = (slope) => Math.atan(slope * view.magnified);
/** @param {Point} one @param {Point} other */
const distance = (one, other) => Math.hypot(one[0] - other[0], one[1] - other[1]);

/** Draw the shaft, outside the model's limits red and dashed, and the bevel, whose point lies where it turns the cut to. @param {Sheet} sheet @param {State} state */
export function paintNeedle(sheet, { x, y, faults, bevel: { side } }) {
  const points = placesOf(x, y);
  const tip = points[points.length - 1];
  const shaft = points.filter((one) => distance(one, tip) > BEVEL.length); // it ends where the bevel begins
  const last = shaft.at(-1) ?? tip;
  const share = 1 - BEVEL.length / (distance(last, tip) || 1);
  const end = /** @type {Point} */ (last.map((from, i) => from + share * (tip[i] - from)));
  polyline(sheet, [[...shaft, end]], faults.length ? palette.bad : palette.needle, LINE, faults.length ? [9, 5] : []);
  // The cut face is drawn as a line of its own: it looks away from the side of the point.
  const size = distance(end, tip) || 1;
  const [dx, dy] = tip.map((to, i) => (BEVEL.half * (to - end[i])) / size);
  /** @type {(place: Point, to: number) => Point} */
  const aside = ([px, py], to) => [px + to * dy, py - to * dx]; // canvas y runs downwards
  const [back, near, point] = [aside(end, -side), aside(end, side), aside(tip, side)];
  polygon(sheet, [back, near, point], palette.needle);
  polyline(sheet, [[back, point]], palette.tip, 2);
}

/** Draw the points that hold the needle in the tissue, as crosses. @param {Sheet} sheet @param {State} state */
export function paintPoints(sheet, { constraints: { x, y } }) {
  const half = Math.min(Math.max(CROSS.of * now.scene.spacing_mm * view.scale, CROSS.least), CROSS.most);
  polyline(sheet, placesOf(x, y).flatMap((place) => cross(place, half, true)), palette.points, 1.2);
  nameLine(sheet, "constraint points", { x, y }, palette.points);
}

/** Draw where the tip was as it came to the depth of each of them. @param {Sheet} sheet @param {State} state */
export function paintPath(sheet, { tip_path: path }) {
  polyline(sheet, [placesOf(path.x, path.y)], palette.path, 1.5);
  nameLine(sheet, "tip path", path, palette.path);
}

/**
 * Draw the lateral load along y, on the side to which it pushes, in space its magnitude above the needle; its scale stands in a
 * corner.
 *
 * @param {Sheet} sheet
 */
export function paintLoad(sheet) {
  const { x, y, load } = describeLoad(now.steered);
  const greatest = max(load, Math.abs);
  if (!greatest) return;
  const [, top] = nice(0, greatest, 1); // a load that grows looks so
  const { box } = view;
  const tall = Math.min(TALLEST, 0.2 * box.height - 10);
  const shaft = placesOf(x, y);
  const edge = shaft.map(([px, py], i) => /** @type {Point} */ ([px, py - (tall * load[i]) / top]));
  polygon(sheet, [...shaft, ...edge.toReversed()], palette.load, 0.32);
  polyline(sheet, [edge], palette.load, 1.25);
  const [left, high] = [box.left + 10, box.top + 6];
  const ends = [high, high + tall].map((py) => /** @type {Point[]} */ ([[left - 4, py], [left + 4, py]]));
  polyline(sheet, [[[left, high], [left, high + tall]], ...ends], palette.load, 1.5);
  const words = `load ${brief(top)} N/mm`;
  now.labels.push([left - 4, high, measure(words, "small") + 16, tall]);
  label(sheet, words, [left + 8, high + tall / 2], { fill: palette.load, align: "start" });
}

/** Keep labels off the needle. @param {State} state */
export const reserveNeedle = ({ x, y }) => avoid(placesOf(x, y));

/** Draw the hub, and the rail along which the stage moves it. @param {Sheet} sheet @param {State} state */
export function paintBase(sheet, { base }) {
  const [px, py] = [toPx(base.x), toPy(base.y)];
  const ends = [-46, 46].map((to) => /** @type {Point[]} */ ([[px - 5, py + to], [px + 5, py + to]]));
  polyline(sheet, [[[px, py - 46], [px, py + 46]], ...ends], palette.quiet, 2);
  sheet.turned([px, py], angleOf(Math.tan(base.rotation)), () => sheet.path("M-22,-7h26v14h-26Z", { fill: palette.ink }));
}

/** Draw each guide: two jaws along its direction if it clamps, two points if the needle turns in it; under it its number or name. @param {Sheet} sheet @param {State} state */
export function paintGuides(sheet, { guides }) {
  for (const guide of guides) {
    const [px, py] = [toPx(guide.x), toPy(guide.y)];
    sheet.turned([px, py], angleOf(guide.slope), () => {
      for (const to of [-1, 1]) {
        const d = guide.turns_freely ? `M0,${GAP * to}l-7,${11 * to}h14Z` : `M-13,${GAP * to}h26v${7 * to}h-26Z`;
        sheet.path(d, { fill: palette.guide });
      }
    });
    if (px >= view.box.left && px <= view.box.left + view.box.width) labelFree(sheet, shortName(guide), [[px, py + 27]], palette.guide);
  }
}
