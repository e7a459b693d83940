/** What the needle is compared with and aimed at, and what the picture itself does not show. */

import { heightAt, isChanged, isSteered, predictionOf } from "../quantities.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { cross, faintly, fillBetween, isFree, label, labelBeside, labelFree, line, palette, placesOf, reserve, segments, setFont, stroke } from "./strokes.js";

const GAPS = 12; // parts of the shaft between which gaps are drawn
const FAN = 0.3; // opacity of the plan's draws
const CROSS = 5; // px
const AWAY = 19; // px, of the tip error from the needle
const INSET = { width: 170, height: 46, edge: 10, title: 14 }; // px
const CLEAR = 30; // px between the inset and curves, for load and crosses

/** Draw the measured needle, over a halo that sets it off from the needle and from a scan. */
export function paintMeasured(context, { x, y }) {
  context.lineCap = "round";
  line(context, x, y, palette.halo, 4);
  line(context, x, y, palette.measured, 2, [7, 4]);
  context.lineCap = "butt";
  nameLine(context, "measured", { x, y }, palette.measured);
}

/** Name a line at its end. */
function nameLine(context, name, { x, y }, colour) {
  labelBeside(context, name, [[[x, y], 16], [[x, y], -16]], colour);
}

/** Name the needle beside another one: it is steered, or has the parameters of the scene. */
export function nameNeedle(context, state) {
  if (predictionOf(state, now.scene)) return;
  nameLine(context, isSteered(state, now.scene) ? "steered" : "simulated", state, state.faults.length ? palette.bad : palette.needle);
}

/** Draw the pinned needle: what the needle is compared with. */
export function paintPinned(context, { x, y }) {
  line(context, x, y, palette.halo, 5);
  line(context, x, y, palette.ghost, 2.5, [2, 3]);
  labelBeside(context, "pinned", [[[x, y], -18], [[x, y], 18]], palette.ghost);
}

/** State that the band is not that of the parameters shown. */
export function nameBand(context, { x, low, high }) {
  if (!isChanged(now.state, now.scene)) return;
  labelBeside(context, "band of the fit", [[[x, high], -14], [[x, low], 14]], palette.band);
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
  line(context, prediction.x, prediction.y, palette.halo, 4.5);
  line(context, prediction.x, prediction.y, palette.accent, 2.5);
  labelBeside(context, "prediction", [[[prediction.x, prediction.y], -16], [[prediction.x, prediction.y], 16]], palette.accent);
}

/** Draw what the errors are: the gap at the tip (TE), and gaps along the shaft, whose mean is the IPE. */
export function paintGaps(context, state, measured) {
  const { errors } = state;
  if (!errors) return;
  const prediction = predictionOf(state, now.scene);
  const needle = prediction ?? state;
  const tip = { x: needle.x.at(-1), y: needle.y.at(-1) };
  const reach = Math.min(tip.x, measured.x.at(-1));
  const places = Array.from({ length: GAPS - 1 }, (_, n) => (reach * (n + 1)) / GAPS);
  const gaps = places.map((x) => [needle, measured].map((curve) => [toPx(x), toPy(heightAt(curve, x))]));
  segments(context, gaps, palette.gap, 1.25);
  const [x, y] = errors.whole ? [measured.x.at(-1), measured.y.at(-1)] : [reach, heightAt(measured, reach)];
  const end = errors.whole ? [tip.x, tip.y] : [reach, heightAt(needle, reach)];
  for (const [shown, width] of [[palette.halo, 5], [palette.gap, 2.5]]) line(context, [x, end[0]], [y, end[1]], shown, width);
  setFont(context, "strong");
  const [px, [, [key, named]]] = [toPx(x), measured.metrics];
  const [top, bottom] = [toPy(y), toPy(end[1])].sort((one, other) => one - other);
  const sides = [[px, top - AWAY], [px, bottom + AWAY]]; // first the one that has no knob of the bevel
  if (state.bevel.side > 0) sides.reverse();
  labelFree(context, `tip error (${named}) ${(prediction?.errors ?? errors)[key].toFixed(2)} mm`, [...sides, [px + 60, top - AWAY], [px + 60, bottom + AWAY], [px - 90, top - AWAY], [px - 90, bottom + AWAY]], palette.gap);
}

/** Draw target, obstacles, and the needles of the draws of a plan. */
export function paintPlan(context, { target: [x, y], radius, obstacles, needles }) {
  faintly(context, FAN, () => {
    for (const [xs, ys] of needles) line(context, xs, ys, palette.plan, 1);
  });
  for (const [at, across, size, name] of obstacles) paintCircle(context, at, across, size, palette.tip, name, 0.28);
  paintCircle(context, x, y, radius, palette.guide, "target");
  segments(context, cross(toPx(x), toPy(y), CROSS), palette.guide, 2);
}

function paintCircle(context, x, y, radius, shown, name, opacity = 0) {
  const [px, py, across] = [toPx(x), toPy(y), radius * view.scale];
  context.beginPath();
  context.ellipse(px, py, across, across * view.magnified, 0, 0, 2 * Math.PI);
  context.fillStyle = shown;
  faintly(context, opacity, () => context.fill());
  stroke(context, palette.halo, 4);
  stroke(context, shown, 2);
  if (px < view.box.left || px > view.box.left + view.box.width) return;
  setFont(context, "strong");
  const sides = [[px, toPy(y + radius) - 12], [px, toPy(y - radius) + 12]];
  if (now.state.bevel.side > 0) sides.reverse(); // the knob of the bevel is on the other one
  labelFree(context, name, sides, shown);
}

/** Draw the inserted part of the needle with y as large as x and its width, in a corner where nothing else is; else nowhere. */
export function paintInset(context, { x, y, tip }) {
  if (tip.x <= 0) return;
  const { left, top, width, height } = view.box;
  const curves = [{ x, y }, now.scene.measured, now.band && { x: now.band.x, y: now.band.low }, now.band && { x: now.band.x, y: now.band.high }];
  const places = curves.flatMap((one) => (one ? placesOf(one.x, one.y) : []));
  const wide = Math.min(INSET.width, 0.36 * width);
  const empty = ([px, py]) => isFree([px, py, wide, INSET.height]) && places.every(([cx, cy]) =>
    cx < px - CLEAR || cx > px + wide + CLEAR || cy < py - CLEAR || cy > py + INSET.height + CLEAR);
  const rows = [top + height - INSET.height - INSET.edge, top + INSET.edge];
  const columns = [left + INSET.edge, left + width - wide - INSET.edge];
  const corner = rows.flatMap((py) => columns.map((px) => [px, py])).find(empty);
  if (!corner) return;
  const [px, py] = corner;
  reserve(px, py, wide, INSET.height);
  context.fillStyle = palette.air;
  context.fillRect(px, py, wide, INSET.height);
  context.strokeStyle = palette.quiet;
  context.lineWidth = 1;
  context.strokeRect(px + 0.5, py + 0.5, wide - 1, INSET.height - 1);
  const inserted = y.filter((_, i) => x[i] >= 0);
  const [low, high] = [Math.min(...inserted), Math.max(...inserted)];
  const scale = Math.min((wide - 2 * INSET.edge) / Math.max(now.scene.depth_mm, now.state.depth_mm, 1), (INSET.height - INSET.title - 6) / (high - low || 1));
  const middle = py + (INSET.height + INSET.title) / 2;
  context.beginPath();
  x.forEach((one, i) => one >= 0 && context.lineTo(px + INSET.edge + one * scale, middle - (y[i] - (low + high) / 2) * scale));
  stroke(context, palette.needle, Math.max(now.scene.diameter_mm * scale, 1));
  setFont(context, "small", "left", "top");
  label(context, "true scale", px + 6, py + 4);
}
