/** What the needle is compared with and aimed at. */

import { bisectLeft, extent, least, range } from "d3-array";
import { isChanged, isSteered, predictionOf } from "../quantities.js";
import { trace, traceBox } from "../sheet.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { countBelow, cross, haloed, label, labelBeside, labelFree, nameLine, palette, placesOf, polyline, traceBetween, traceEllipse } from "./strokes.js";

const GAPS = 12; // parts of the shaft between which gaps are drawn
const FAN = 0.3; // opacity of the plan's draws
const CROSS = 5; // px
const DOT = 4; // px, radius of a measured tip
const AWAY = 19; // px, of the tip error from the needle
const BAND_REACH = 2; // mm
const INSET = { width: 0.3, height: 0.25, edge: 10, title: 16 }; // of the window, at most; px

/** Draw the measured needle, or its tip where no more was measured. @param {Sheet} sheet @param {Curve} curve */
export function paintMeasured(sheet, curve) {
  const [place] = placesOf(curve.x, curve.y);
  if (isTip(curve)) sheet.path(traceEllipse(place, DOT, DOT), { fill: palette.halo, stroke: palette.measured, width: 2 });
  else haloed(sheet, curve, palette.measured, 2, [7, 4]);
  nameLine(sheet, isTip(curve) ? "measured tip" : "measured", curve, palette.measured);
}

/** @param {Curve} curve */
const isTip = ({ x }) => x.length === 1;

/** Draw the pinned needle: the needle as it stood. @param {Sheet} sheet @param {Curve} pinned */
export function paintPinned(sheet, pinned) {
  haloed(sheet, pinned, palette.pinned, 2.5, [2, 3]);
  nameLine(sheet, "pinned", pinned, palette.pinned);
}

/** Name the needle beside another one: it is steered, or has the parameters of the scene. @param {Sheet} sheet @param {State} state */
export function nameNeedle(sheet, state) {
  if (predictionOf(state, now.scene)) return;
  nameLine(sheet, isSteered(state, now.scene) ? "steered" : "simulated", state, state.faults.length ? palette.bad : palette.needle);
}

/** State that the band is not that of the parameters shown. @param {Sheet} sheet @param {Band} band */
export function nameBand(sheet, { x, low, high }) {
  if (!isChanged(now.state, now.scene)) return;
  labelBeside(sheet, "band of the fit", [[{ x, y: high }, -14], [{ x, y: low }, 14]], palette.band);
}

/** Whether the band ends about where the needle does. @param {Band} band @param {State} state */
export const isBandNear = ({ x }, state) => x.length > 0 && Math.abs(x[x.length - 1] - state.tip.x) <= BAND_REACH;

/** Draw the band; pale as long as it belongs to an earlier step. @param {Sheet} sheet @param {Band} band @param {boolean} pale */
export function paintBand(sheet, { x, low, high }, pale) {
  sheet.path(traceBetween(x, low, high), { fill: palette.band, opacity: pale ? 0.16 : 0.4 });
  for (const edge of [low, high]) polyline(sheet, [placesOf(x, edge)], palette.band, pale ? 0.75 : 1.5);
}

/** Draw the predicted needle, if it stands for the needle. @param {Sheet} sheet @param {State} state */
export function paintPrediction(sheet, state) {
  const prediction = predictionOf(state, now.scene);
  if (!prediction) return;
  haloed(sheet, prediction, palette.accent, 2.5);
  nameLine(sheet, "prediction", prediction, palette.accent);
}

/** The y of a curve at x, its points joined by straight lines. @param {Curve} curve @param {number} x */
function heightAt({ x: xs, y: ys }, x) {
  const after = Math.min(Math.max(bisectLeft(xs, x), 1), xs.length - 1);
  const share = Math.min(Math.max((x - xs[after - 1]) / (xs[after] - xs[after - 1]), 0), 1);
  return ys[after - 1] + share * (ys[after] - ys[after - 1]);
}

/** Draw what the errors are: the gap at the tip (TE), and gaps along the shaft, whose mean is the IPE. @param {Sheet} sheet @param {State} state @param {Curve} measured */
export function paintGaps(sheet, state, measured) {
  const { errors } = state;
  if (!errors) return;
  const prediction = predictionOf(state, now.scene);
  const needle = prediction ?? state;
  const [tip, other] = [needle, measured].map(({ x, y }) => ({ x: x[x.length - 1], y: y[y.length - 1] }));
  const reach = Math.min(tip.x, other.x);
  /** @param {number} x */
  const across = (x) => [needle, measured].map((curve) => /** @type {Point} */ ([toPx(x), toPy(heightAt(curve, x))]));
  const places = isTip(measured) ? [] : range(1, GAPS).map((n) => (reach * n) / GAPS);
  polyline(sheet, places.map(across), palette.gap, 1.25);
  const ends = errors.whole ? [tip, other].map(({ x, y }) => /** @type {Point} */ ([toPx(x), toPy(y)])) : across(reach);
  for (const [shade, width] of /** @type {[string, number][]} */ ([[palette.halo, 5], [palette.gap, 2.5]])) polyline(sheet, [ends], shade, width);
  const px = ends[1][0];
  const [top, bottom] = /** @type {Point} */ (extent(ends, ([, py]) => py));
  const beside = [0, 60, -90].flatMap((aside) => [top - AWAY, bottom + AWAY].map((py) => /** @type {Point} */ ([px + aside, py])));
  labelFree(sheet, `tip error (TE) ${(prediction?.errors ?? errors).te_mm.toFixed(2)} mm`, beside, palette.gap);
}

/** Draw target, obstacles, and the needles of the draws of a plan. @param {Sheet} sheet @param {Plan} plan */
export function paintPlan(sheet, { target: [x, y], radius, obstacles, needles }) {
  for (const [xs, ys] of needles) sheet.path(trace(placesOf(xs, ys)), { stroke: palette.plan, opacity: FAN });
  for (const [along, across, size, name] of obstacles) paintCircle(sheet, along, across, size, palette.tip, name, 0.28);
  paintCircle(sheet, x, y, radius, palette.guide, "target");
  polyline(sheet, cross([toPx(x), toPy(y)], CROSS), palette.guide, 2);
}

/** @param {Sheet} sheet @param {number} x @param {number} y @param {number} radius @param {string} shade @param {string} name */
function paintCircle(sheet, x, y, radius, shade, name, opacity = 0) {
  const [px, size] = [toPx(x), radius * view.scale];
  const edge = traceEllipse([px, toPy(y)], size, size * view.magnified);
  sheet.path(edge, { fill: shade, opacity });
  sheet.path(edge, { stroke: palette.halo, width: 4 });
  sheet.path(edge, { stroke: shade, width: 2 });
  if (px < view.box.left || px > view.box.left + view.box.width) return;
  labelFree(sheet, name, [[px, toPy(y + radius) - 12], [px, toPy(y - radius) + 12]], shade);
}

/** Draw the whole inserted part of the needle with y as large as x and as wide as it is, in the emptiest corner. @param {Sheet} sheet @param {State} state */
export function paintInset(sheet, { x, y }) {
  const points = range(x.length).filter((i) => x[i] >= 0);
  if (points.length < 2) return;
  const { box } = view;
  const { diameter_mm: thick } = now.scene;
  const [first, last] = [x[points[0]], x[x.length - 1]];
  const [low, high] = /** @type {Point} */ (extent(points, (i) => y[i]));
  const scale = Math.min((INSET.width * box.width) / (last - first + thick), (INSET.height * box.height) / (high - low + thick));
  const size = { width: (last - first + thick) * scale + 2 * INSET.edge, height: (high - low + thick) * scale + INSET.edge + INSET.title };
  const corners = [box.top + box.height - size.height - INSET.edge, box.top + INSET.edge].flatMap((top) =>
    [box.left + INSET.edge, box.left + box.width - size.width - INSET.edge].map((left) => ({ left, top, ...size })));
  const frame = /** @type {Box} */ (least(corners, ({ left, top }) => countBelow([left, top, size.width, size.height])));
  now.labels.push([frame.left, frame.top, size.width, size.height]);
  sheet.path(traceBox(frame), { fill: palette.air, stroke: palette.quiet });
  /** @param {number} i @returns {Point} */
  const place = (i) => [frame.left + INSET.edge + (x[i] - first + thick / 2) * scale, frame.top + INSET.title + (high - y[i] + thick / 2) * scale];
  polyline(sheet, [points.map(place)], palette.needle, Math.max(thick * scale, 1));
  label(sheet, "true scale", [frame.left + 6, frame.top + INSET.title / 2], { align: "start" });
}
