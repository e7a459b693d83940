/** What the needle is compared with and aimed at. */

import { extent, least, range } from "d3-array";
import { interpolate } from "../model/errors.js";
import { isChanged, isSteered, predictionOf } from "../quantities.js";
import { path, text, trace, traceBox } from "../sheet.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { countBelow, cross, haloed, labelBeside, labelFree, nameLine, placesOf, polyline, traceBetween, traceEllipse } from "./strokes.js";

const GAPS = 12; // parts of the shaft between which gaps are drawn
const FAN = 0.3; // opacity of the plan's draws
const CROSS = 5; // px
const DOT = 4; // px, radius of a tip
const AWAY = 19; // px, of the tip error from the needle
const BAND_REACH = 2; // mm
const INSET = { width: 0.3, height: 0.25, edge: 10, title: 16 }; // of the window, at most; px

/** @param {Curve} curve */
const isTip = ({ x }) => x.length === 1;

/** Draw a needle that is compared, or its tip where no more of it is known, and name it. @param {string} words @param {Curve} curve @param {string} shade @param {number} width @param {number[]} [dash] */
export function paintCompared(words, curve, shade, width, dash) {
  if (isTip(curve)) path(traceEllipse(placesOf(curve)[0], DOT, DOT), { fill: "halo", stroke: shade, width: 2 });
  else haloed(curve, shade, width, dash);
  nameLine(isTip(curve) ? `${words} tip` : words, curve, shade);
}

/** Name the needle beside another one: it is steered, or has the parameters of the scene. @param {State} state */
export function nameNeedle(state) {
  if (predictionOf(state, now.scene)) return;
  nameLine(isSteered(state, now.scene) ? "steered" : "simulated", state, state.faults.length ? "bad" : "needle");
}

/** State that the band is not that of the parameters shown. @param {Band} band */
export function nameBand({ x, low, high }) {
  if (!isChanged(now.state, now.scene)) return;
  labelBeside("band of the fit", [[{ x, y: high }, -14], [{ x, y: low }, 14]], "band");
}

/** Whether the band ends about where the needle does. @param {Band} band @param {State} state */
export const isBandNear = ({ x }, state) => x.length > 0 && Math.abs(x[x.length - 1] - state.tip.x) <= BAND_REACH;

/** Draw the band; pale as long as it belongs to an earlier step. @param {Band} band @param {boolean} pale */
export function paintBand({ x, low, high }, pale) {
  path(traceBetween(x, low, high), { fill: "band", opacity: pale ? 0.16 : 0.4 });
  for (const edge of [low, high]) polyline([placesOf({ x, y: edge })], "band", pale ? 0.75 : 1.5);
}

/** Draw what the errors are: the gap at the tip (TE), and gaps along the shaft, whose mean is the IPE. @param {State} state @param {Measured} measured */
export function paintGaps(state, measured) {
  const { errors } = state;
  if (!errors) return;
  const prediction = predictionOf(state, now.scene);
  const needle = prediction ?? state;
  const [tip, other] = [needle, measured].map(({ x, y }) => ({ x: x[x.length - 1], y: y[y.length - 1] }));
  const reach = Math.min(tip.x, other.x);
  /** @param {number} x */
  const across = (x) => [needle, measured].map((curve) => /** @type {Point} */ ([toPx(x), toPy(interpolate(curve.x, curve.y, x))]));
  const places = isTip(measured) ? [] : range(1, GAPS).map((n) => (reach * n) / GAPS);
  polyline(places.map(across), "gap", 1.25);
  const te = (prediction?.errors ?? errors).te_mm;
  if (te === null) return;
  if (measured.tip) [[other.x], [other.y]] = [measured.tip.x, measured.tip.y];
  const ends = errors.whole ? [tip, other].map(({ x, y }) => /** @type {Point} */ ([toPx(x), toPy(y)])) : across(reach);
  for (const [shade, width] of /** @type {[string, number][]} */ ([["halo", 5], ["gap", 2.5]])) polyline([ends], shade, width);
  const px = ends[1][0];
  const [top, bottom] = /** @type {Point} */ (extent(ends, ([, py]) => py));
  const beside = [0, 60, -90].flatMap((aside) => [top - AWAY, bottom + AWAY].map((py) => /** @type {Point} */ ([px + aside, py])));
  labelFree(`tip error (TE) ${te.toFixed(2)} mm`, beside, "gap");
}

/** Draw target, obstacles, and the needles of the draws of a plan. @param {Plan} plan */
export function paintPlan({ target: [x, y], radius, obstacles, needles }) {
  for (const [xs, ys] of needles) path(trace(placesOf({ x: xs, y: ys })), { stroke: "plan", opacity: FAN });
  for (const [along, across, size, name] of obstacles) paintCircle(along, across, size, "tip", name, 0.28);
  paintCircle(x, y, radius, "guide", "target");
  polyline(cross([toPx(x), toPy(y)], CROSS), "guide", 2);
}

/** @param {number} x @param {number} y @param {number} radius @param {string} shade @param {string} name */
function paintCircle(x, y, radius, shade, name, opacity = 0) {
  const [px, size] = [toPx(x), radius * view.scale];
  const edge = traceEllipse([px, toPy(y)], size, size * view.magnified);
  path(edge, { fill: shade, opacity });
  path(edge, { stroke: "halo", width: 4 });
  path(edge, { stroke: shade, width: 2 });
  if (px < view.box.left || px > view.box.left + view.box.width) return;
  labelFree(name, [[px, toPy(y + radius) - 12], [px, toPy(y - radius) + 12]], shade);
}

/** Draw the inserted part of the needle at true scale in the emptiest corner. @param {State} state */
export function paintInset({ x, y }) {
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
  path(traceBox(frame), { fill: "air", stroke: "quiet" });
  /** @param {number} i @returns {Point} */
  const place = (i) => [frame.left + INSET.edge + (x[i] - first + thick / 2) * scale, frame.top + INSET.title + (high - y[i] + thick / 2) * scale];
  polyline([points.map(place)], "needle", Math.max(thick * scale, 1));
  text("true scale", [frame.left + 6, frame.top + INSET.title / 2], { align: "start", halo: true });
}
