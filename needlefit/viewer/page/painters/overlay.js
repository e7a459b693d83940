/** What the needle is compared with and aimed at. */

import { bisectLeft, range } from "d3-array";
import { isChanged, isSteered, predictionOf } from "../quantities.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { cross, faintly, fillBetween, haloed, labelBeside, labelFree, line, palette, polygon, polyline, ring, setFont } from "./strokes.js";

const GAPS = 12; // parts of the shaft between which gaps are drawn
const FAN = 0.3; // opacity of the plan's draws
const CROSS = 5; // px
const CORNERS = 72; // of a circle, which is an ellipse where y is drawn larger
const DOT = 4; // px, radius of a measured tip
const AWAY = 19; // px, of the tip error from the needle

/** Draw the measured needle, or its tip where no more was measured. */
export function paintMeasured(context, curve) {
  const { x: [x], y: [y] } = curve;
  if (isTip(curve)) ring(context, toPx(x), toPy(y), DOT, palette.measured, palette.halo);
  else haloed(context, curve, palette.measured, 2, [7, 4]);
  nameLine(context, isTip(curve) ? "measured tip" : "measured", curve, palette.measured);
}

const isTip = ({ x }) => x.length === 1;

/** Name a line at its end. */
function nameLine(context, name, curve, shade) {
  labelBeside(context, name, [[curve, 16], [curve, -16]], shade);
}

/** Name the needle beside another one: it is steered, or has the parameters of the scene. */
export function nameNeedle(context, state) {
  if (predictionOf(state, now.scene)) return;
  nameLine(context, isSteered(state, now.scene) ? "steered" : "simulated", state, state.faults.length ? palette.bad : palette.needle);
}

/** State that the band is not that of the parameters shown. */
export function nameBand(context, { x, low, high }) {
  if (!isChanged(now.state, now.scene)) return;
  labelBeside(context, "band of the fit", [[{ x, y: high }, -14], [{ x, y: low }, 14]], palette.band);
}

const BAND_REACH = 2; // mm

/** Whether the band ends about where the needle does. */
export const isBandNear = ({ x }, state) => x.length > 0 && Math.abs(x.at(-1) - state.x.at(-1)) <= BAND_REACH;

/** Draw the band; pale as long as it belongs to an earlier step. */
export function paintBand(context, { x, low, high }, pale) {
  faintly(context, pale ? 0.16 : 0.4, () => fillBetween(context, x, low, high, palette.band));
  faintly(context, pale ? 0.4 : 1, () => {
    for (const edge of [low, high]) line(context, x, edge, palette.band, 1.5);
  });
}

/** Draw the predicted needle, if it stands for the needle. */
export function paintPrediction(context, state) {
  const prediction = predictionOf(state, now.scene);
  if (!prediction) return;
  haloed(context, prediction, palette.accent, 2.5);
  nameLine(context, "prediction", prediction, palette.accent);
}

/** The y of a curve at x, its points joined by straight lines. */
function heightAt({ x: xs, y: ys }, x) {
  const after = Math.min(Math.max(bisectLeft(xs, x), 1), xs.length - 1);
  const share = Math.min(Math.max((x - xs[after - 1]) / (xs[after] - xs[after - 1]), 0), 1);
  return ys[after - 1] + share * (ys[after] - ys[after - 1]);
}

/** Draw what the errors are: the gap at the tip (TE), and gaps along the shaft, whose mean is the IPE. */
export function paintGaps(context, state, measured) {
  const { errors } = state;
  if (!errors) return;
  const prediction = predictionOf(state, now.scene);
  const needle = prediction ?? state;
  const tip = { x: needle.x.at(-1), y: needle.y.at(-1) };
  const reach = Math.min(tip.x, measured.x.at(-1));
  const places = isTip(measured) ? [] : Array.from({ length: GAPS - 1 }, (_, n) => (reach * (n + 1)) / GAPS);
  const gaps = places.map((x) => [needle, measured].map((curve) => [toPx(x), toPy(heightAt(curve, x))]));
  polyline(context, gaps, palette.gap, 1.25);
  const [x, y] = errors.whole ? [measured.x.at(-1), measured.y.at(-1)] : [reach, heightAt(measured, reach)];
  const end = errors.whole ? [tip.x, tip.y] : [reach, heightAt(needle, reach)];
  for (const [shown, width] of [[palette.halo, 5], [palette.gap, 2.5]]) line(context, [x, end[0]], [y, end[1]], shown, width);
  setFont(context, "strong");
  const px = toPx(x);
  const [top, bottom] = [toPy(y), toPy(end[1])].sort((one, other) => one - other);
  const sides = [[px, top - AWAY], [px, bottom + AWAY]];
  labelFree(context, `tip error (TE) ${(prediction?.errors ?? errors).te_mm.toFixed(2)} mm`, [...sides, [px + 60, top - AWAY], [px + 60, bottom + AWAY], [px - 90, top - AWAY], [px - 90, bottom + AWAY]], palette.gap);
}

/** Draw target, obstacles, and the needles of the draws of a plan. */
export function paintPlan(context, { target: [x, y], radius, obstacles, needles }) {
  faintly(context, FAN, () => {
    for (const [xs, ys] of needles) line(context, xs, ys, palette.plan, 1);
  });
  for (const [at, across, size, name] of obstacles) paintCircle(context, at, across, size, palette.tip, name, 0.28);
  paintCircle(context, x, y, radius, palette.guide, "target");
  polyline(context, cross(toPx(x), toPy(y), CROSS), palette.guide, 2);
}

function paintCircle(context, x, y, radius, shade, name, opacity = 0) {
  const [px, py, across] = [toPx(x), toPy(y), radius * view.scale];
  const edge = range(0, CORNERS + 1).map((n) => (2 * Math.PI * n) / CORNERS)
    .map((angle) => [px + across * Math.cos(angle), py + across * view.magnified * Math.sin(angle)]);
  faintly(context, opacity, () => polygon(context, edge, shade));
  polyline(context, [edge], palette.halo, 4);
  polyline(context, [edge], shade, 2);
  if (px < view.box.left || px > view.box.left + view.box.width) return;
  setFont(context, "strong");
  const sides = [[px, toPy(y + radius) - 12], [px, toPy(y - radius) + 12]];
  labelFree(context, name, sides, shade);
}
