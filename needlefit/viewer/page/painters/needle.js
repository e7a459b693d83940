/** The needle, and what holds it. */

import { shortName } from "../quantities.js";
import { toPx, toPy, view } from "../view.js";
import { avoid, labelFree, palette, placesOf, polygon, polyline, setFont, turned } from "./strokes.js";

const LINE = 2.5; // px, of the needle
const BEVEL = { length: 7.5, half: 1.5 }; // px
const GAP = 3; // px between the axis of the needle and a guide

/** The direction in the picture of a slope. */
const angleOf = (slope) => Math.atan(slope * view.magnified);
const distance = (one, other) => Math.hypot(one[0] - other[0], one[1] - other[1]);

/** The shaft on the canvas (px), which ends before the tip, where the bevel begins; its colour: outside the model it looks different. */
function describeShaft({ x, y, faults }) {
  const outside = faults?.length > 0;
  const points = placesOf(x, y);
  const tip = points.at(-1);
  const shaft = points.filter((one) => distance(one, tip) > BEVEL.length);
  const last = shaft.at(-1) ?? tip;
  const share = 1 - BEVEL.length / (distance(last, tip) || 1);
  shaft.push(last.map((from, i) => from + share * (tip[i] - from)));
  return { shaft, tip, outside, shown: outside ? palette.bad : palette.needle };
}

/** Draw the shaft, and the bevel, whose point lies where it turns the cut to. */
export function paintNeedle(context, state) {
  const { shaft, tip, outside, shown } = describeShaft(state);
  polyline(context, [shaft], shown, LINE, outside ? [9, 5] : []);
  // The cut face is drawn as a line of its own: it looks away from the side of the point.
  const [end, { half }, { side }] = [shaft.at(-1), BEVEL, state.bevel];
  const size = distance(end, tip) || 1;
  const [dx, dy] = tip.map((to, i) => (to - end[i]) / size);
  const at = ([px, py], to) => [px + to * dy * half, py - to * dx * half]; // canvas y runs downwards
  const [back, near, point] = [at(end, -side), at(end, side), at(tip, side)];
  polygon(context, [back, near, point], palette.needle);
  polyline(context, [[back, point]], palette.tip, 2);
}

/** Keep labels off the needle. */
export const reserveNeedle = ({ x, y }) => avoid(placesOf(x, y));

/** Draw the hub, and the rail along which the stage moves it. */
export function paintBase(context, { base }) {
  const [px, py] = [toPx(base.x), toPy(base.y)];
  const ends = [-46, 46].map((to) => [[px - 5, py + to], [px + 5, py + to]]);
  polyline(context, [[[px, py - 46], [px, py + 46]], ...ends], palette.quiet, 2);
  turned(context, px, py, angleOf(Math.tan(base.rotation)), () => box(context, -22, -7, 26, 14, palette.ink));
}

const box = (context, px, py, width, height, shade) =>
  polygon(context, [[px, py], [px + width, py], [px + width, py + height], [px, py + height]], shade);

/** Draw each guide: two jaws along its direction if it clamps, two points if the needle turns in it. */
export function paintGuides(context, { guides }) {
  for (const guide of guides) {
    turned(context, toPx(guide.x), toPy(guide.y), angleOf(guide.slope), () => {
      for (const to of [-1, 1]) {
        const from = GAP * to;
        if (!guide.turns_freely) box(context, -13, Math.min(from, from + 7 * to), 26, 7, palette.guide);
        else polygon(context, [[0, from], [-7, from + 11 * to], [7, from + 11 * to]], palette.guide);
      }
    });
  }
  writeNames(context, guides);
}

/** Under each guide its number, or the name that its scene gives it; of two that would overlap, the first. */
function writeNames(context, guides) {
  setFont(context, "strong");
  for (const guide of guides.toSorted((one, other) => one.item - other.item)) {
    const [px, py] = [toPx(guide.x), toPy(guide.y) + 27];
    if (px < view.box.left || px > view.box.left + view.box.width) continue; // out of the picture
    labelFree(context, shortName(guide), [[px, py]], palette.guide);
  }
}
