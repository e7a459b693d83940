/** The needle, what holds it, and what the tissue puts on its shaft. */

import { bisect, max, tickStep } from "d3-array";
import { basePlace, bevelPlace, guidePlace } from "../handles.js";
import { brief, shortName } from "../quantities.js";
import { now, tipForce } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { arrow, avoid, cross, faintly, label, labelFree, line, palette, placesOf, polygon, polyline, reserve, ring, setFont, turned } from "./strokes.js";

const LINE = 2.5; // px, of the needle: its width stands in the inset
const CROSS = { of: 0.28, least: 1, most: 3.2 }; // half a cross: part of the spacing, px
const BEVEL = { length: 7.5, half: 1.5 }; // px
const GAP = 3; // px between the axis of the needle and a guide
const LOWEST = 16; // px, of the load's curve
const tallest = () => Math.min(48, 0.2 * view.box.height - 10); // px, of that and of the force's arrow: both have room above the needle
const SHORTEST = 5; // px, of the arrow of a force; a shorter one is not drawn
const LEAST_FORCE = 0.5; // N, for which an arrow may be the tallest
const LEAST_LOAD = 1e-6; // N/mm; less is drawn as nothing

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

/** Keep labels off the needle, the crosses, the bevel's knob and the arrow of the tip force. */
export function reserveNeedle(state) {
  const { tip: [px, py], turn } = bevelPlace(state);
  reserve(turn[0] - 9, turn[1] - 9, 18, 18);
  const arrow = Array.from({ length: 5 }, (_, i) => [px, py - (i / 6) * arrowLength()]); // its force is written at its end
  const { constraints: [along, across] } = state;
  avoid([...placesOf(state.x, state.y), ...placesOf(along, across), ...arrow]);
}

/** Length of the arrow of the tip force, px, up if positive. */
function arrowLength() {
  const { y } = now.forces;
  return (tallest() * (tipForce() ?? 0)) / Math.max(LEAST_FORCE, max(y, Math.abs) ?? 0); // one scale along the way
}

/** Draw the knob on the side to which the bevel turns the cut. */
export function paintBevel(context, state) {
  const { tip, turn } = bevelPlace(state);
  polyline(context, [[tip, turn]], palette.tip, 1.5);
  ring(context, ...turn, 6, palette.air, palette.tip);
  setFont(context, "small");
  labelFree(context, "bevel", [[turn[0] + 29, turn[1]], [turn[0], turn[1] - 18 * state.bevel.side]], palette.tip);
}

/** Draw the tip force as an arrow along y; of a needle in space it does not lie in the picture. */
export function paintTipForce(context, { tip, z }) {
  if (z) return;
  const [force, length] = [tipForce(), arrowLength()];
  if (Math.abs(length) < SHORTEST) return;
  const [px, py] = [toPx(tip.x), toPy(tip.y)];
  arrow(context, [px, py], length, palette.load);
  setFont(context, "small");
  const [end, half] = [py - length - 9 * Math.sign(length), py - length / 2];
  const places = [[px, end], [px - 34, end], [px + 30, end], [px + 30, half], [px - 34, half], [px, end - 14 * Math.sign(length)]];
  labelFree(context, `${brief(Math.abs(force ?? 0), 2)} N`, places, palette.load);
}

export const paintPath = (context, { tip_path: [x, y] }) => line(context, x, y, palette.path, 1.5);

/** Draw the points that hold the needle in the tissue, as crosses. */
export function paintPoints(context, { constraints: [x, y] }) {
  const half = Math.min(Math.max(CROSS.of * now.scene.spacing_mm * view.scale, CROSS.least), CROSS.most);
  const crosses = placesOf(x, y).flatMap((place) => cross(...place, half, true));
  polyline(context, crosses, palette.points, half > 2 ? 1.4 : 1);
}

/** Draw the hub, and the rail along which the stage moves it. */
export function paintBase(context, state) {
  const { place: [px, py], angle } = basePlace(state);
  const ends = [-46, 46].map((to) => [[px - 5, py + to], [px + 5, py + to]]);
  polyline(context, [[[px, py - 46], [px, py + 46]], ...ends], palette.quiet, 2);
  turned(context, px, py, angle, () => box(context, -22, -7, 26, 14, palette.ink));
}

const box = (context, px, py, width, height, shade) =>
  polygon(context, [[px, py], [px + width, py], [px + width, py + height], [px, py + height]], shade);

/** Draw each guide: two jaws along its direction if it clamps, two points if the needle turns in it. */
export function paintGuides(context, { guides }) {
  for (const guide of guides) {
    const { place, angle } = guidePlace(guide);
    turned(context, ...place, angle, () => {
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

/**
 * Draw the lateral load, N/mm, along y, on the side to which it pushes: a filled curve with a scale of its own.
 * Of a needle in space it is its magnitude, above the needle.
 *
 * Between constraint points the load of the model is a sawtooth; its mean over two spacings is what the
 * tissue means to the shaft.
 */
export function paintLoad(context, { load: { x, y, n_per_mm: values } }) {
  const planes = values.map((one) => smooth(x, one, now.scene.spacing_mm));
  const load = planes.length === 1 ? planes[0] : planes[0].map((one, i) => Math.hypot(one, planes[1][i]));
  const greatest = load.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
  if (greatest < LEAST_LOAD || x.length < 2) return;
  // The scale stays while the curve is neither too tall nor too low: a load that grows shall look so.
  const height = greatest * view.per_load;
  if (height > tallest() || height < Math.min(LOWEST, tallest() / 3)) view.per_load = (0.75 * tallest()) / (2 * tickStep(0, greatest, 1));
  const [px, py] = [x.map(toPx), y.map(toPy)];
  const [surface, ends] = [0, view.per_load].map((scale) => px.map((x, i) => [x, py[i] - load[i] * scale]));
  faintly(context, 0.32, () => polygon(context, [...surface, ...ends.toReversed()], palette.load));
  polyline(context, [[...surface.slice(0, 1), ...ends, ...surface.slice(-1)]], palette.load, 1.25);
}

/** The mean of a load over so many mm to either side of each of its places; less at the ends. */
function smooth(x, load, reach) {
  const sums = [0]; // of the load up to each place, trapezia
  for (let i = 1; i < x.length; i += 1) sums.push(sums[i - 1] + ((load[i] + load[i - 1]) / 2) * (x[i] - x[i - 1]));
  const sumTo = (at) => {
    const i = bisect(x, at); // the first place beyond
    if (i === 0 || i === x.length) return sums[Math.max(i - 1, 0)];
    const part = (at - x[i - 1]) / (x[i] - x[i - 1]);
    return sums[i - 1] + (load[i - 1] + (part * (load[i] - load[i - 1])) / 2) * (at - x[i - 1]);
  };
  return x.map((at, i) => {
    const half = Math.min(reach, at - x[0], x.at(-1) - at);
    return half > 0 ? (sumTo(at + half) - sumTo(at - half)) / (2 * half) : load[i];
  });
}

/** The length of a round load, at the upper left, outside the window. */
export function paintKey(context) {
  if (!view.per_load) return;
  const size = tickStep(0, 28 / view.per_load, 1);
  const [px, height] = [7, size * view.per_load];
  const py = view.box.top - 6 - height;
  polyline(context, [[[px, py], [px, py + height]], ...[py, py + height].map((end) => [[px - 3, end], [px + 3, end]])], palette.load, 1.5);
  setFont(context, "small", "left");
  label(context, `${brief(size)} N/mm`, px + 6, py + height / 2);
}
