/** The needle, what holds it, and what the tissue puts on its shaft. */

import { max, nice } from "d3-array";
import { describeLoad } from "../model/state.js";
import { brief, shortName } from "../quantities.js";
import { measure, path, text, turned } from "../sheet.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { cross, labelFree, nameLine, placesOf, polygon, polyline } from "./strokes.js";

const LINE = 2.5; // px, of the needle
const BEVEL = { length: 7.5, half: 1.5 }; // px
const GAP = 3; // px between the axis of the needle and a guide
const CROSS = { of: 0.28, least: 1, most: 3.2 }; // half a cross: part of the spacing, px
const TALLEST = 36; // px, of the load's curve and of its scale, which stand above window and needle

/** The direction in the picture of a slope. @param {number} slope */
const angleOf = (slope) => Math.atan(slope * view.magnified);
/** @param {Point} one @param {Point} other */
const distance = (one, other) => Math.hypot(one[0] - other[0], one[1] - other[1]);

/** Draw the shaft, outside the model's limits red and dashed, and the bevel. @param {State} state */
export function paintNeedle({ x, y, faults, bevel: { side } }) {
  const points = placesOf({ x, y });
  const tip = points[points.length - 1];
  const shaft = points.filter((one) => distance(one, tip) > BEVEL.length); // it ends where the bevel begins
  const last = shaft.at(-1) ?? tip;
  const share = 1 - BEVEL.length / (distance(last, tip) || 1);
  const end = /** @type {Point} */ (last.map((from, i) => from + share * (tip[i] - from)));
  polyline([[...shaft, end]], faults.length ? "bad" : "needle", LINE, faults.length ? [9, 5] : []);
  // The cut face is drawn as a line of its own: it looks away from the side of the point.
  const size = distance(end, tip) || 1;
  const [dx, dy] = tip.map((to, i) => (BEVEL.half * (to - end[i])) / size);
  /** @type {(place: Point, to: number) => Point} */
  const aside = ([px, py], to) => [px + to * dy, py - to * dx]; // canvas y runs downwards
  const [back, near, point] = [aside(end, -side), aside(end, side), aside(tip, side)];
  polygon([back, near, point], "needle");
  polyline([[back, point]], "tip", 2);
}

/** Draw the points that hold the needle in the tissue, as crosses. @param {State} state */
export function paintPoints({ constraints: { x, y } }) {
  const half = Math.min(Math.max(CROSS.of * now.scene.spacing_mm * view.scale, CROSS.least), CROSS.most);
  polyline(placesOf({ x, y }).flatMap((place) => cross(place, half, true)), "points", 1.2);
  nameLine("constraint points", { x, y }, "points");
}

/** Draw where the tip was as it came to the depth of each of them. @param {State} state */
export function paintPath({ tip_path: curve }) {
  polyline([placesOf(curve)], "path", 1.5);
  nameLine("tip path", curve, "path");
}

/** Draw the lateral load, on the side to which it pushes, in space its magnitude above the needle. */
export function paintLoad() {
  const { x, y, load } = describeLoad(now.steered);
  const greatest = max(load, Math.abs);
  if (!greatest) return;
  const [, top] = nice(0, greatest, 1); // a load that grows looks so
  const { box } = view;
  const tall = Math.min(TALLEST, 0.2 * box.height - 10);
  const shaft = placesOf({ x, y });
  const edge = shaft.map(([px, py], i) => /** @type {Point} */ ([px, py - (tall * load[i]) / top]));
  polygon([...shaft, ...edge.toReversed()], "load", 0.32);
  polyline([edge], "load", 1.25);
  const [left, high] = [box.left + 10, box.top + 6];
  const ends = [high, high + tall].map((py) => /** @type {Point[]} */ ([[left - 4, py], [left + 4, py]]));
  polyline([[[left, high], [left, high + tall]], ...ends], "load", 1.5);
  const words = `load ${brief(top)} N/mm`;
  now.labels.push([left - 4, high, measure(words, "small") + 16, tall]);
  text(words, [left + 8, high + tall / 2], { fill: "load", align: "start", halo: true });
}

/** Draw the hub, and the rail along which the stage moves it. @param {State} state */
export function paintBase({ base }) {
  const [px, py] = [toPx(base.x), toPy(base.y)];
  const ends = [-46, 46].map((to) => /** @type {Point[]} */ ([[px - 5, py + to], [px + 5, py + to]]));
  polyline([[[px, py - 46], [px, py + 46]], ...ends], "quiet", 2);
  turned([px, py], angleOf(Math.tan(base.rotation)), () => path("M-22,-7h26v14h-26Z", { fill: "ink" }));
}

/** Draw each guide, two jaws if it clamps, else two points; under it its number or name. @param {State} state */
export function paintGuides({ guides }) {
  for (const guide of guides) {
    const [px, py] = [toPx(guide.x), toPy(guide.y)];
    turned([px, py], angleOf(guide.slope), () => {
      for (const to of [-1, 1]) {
        const d = guide.turns_freely ? `M0,${GAP * to}l-7,${11 * to}h14Z` : `M-13,${GAP * to}h26v${7 * to}h-26Z`;
        path(d, { fill: "guide" });
      }
    });
    if (px >= view.box.left && px <= view.box.left + view.box.width) labelFree(shortName(guide), [[px, py + 27]], "guide");
  }
}
