/** The picture from the side, and of a needle in space from above, with z in place of y: the same painters, the same layers. */

import { extent } from "d3-array";
import { brief } from "../quantities.js";
import { now } from "../store.js";
import { look, view } from "../view.js";
import { paintAxes, paintFrame, paintTissue } from "./background.js";
import * as needle from "./needle.js";
import * as overlay from "./overlay.js";
import { avoid, clearLabels, label, palette, placesOf } from "./strokes.js";

const [EDGE, ROOM] = [8, 14]; // px above and below the window of the view from above, and in it

/** Whether something is seen from above: a needle in space, or one that is compared there. */
export const isSpatial = () => Boolean(now.state?.z ?? now.scene?.measured?.compared === "space");

/** What is shown and known; while a needle moves faster than draws are computed, their band is of a place that it has left. */
function listShown() {
  const { state, shown, scene, band, pinned } = now;
  return {
    state,
    band: shown.band && band && overlay.isBandNear(band, state) ? band : null,
    measured: shown.measured ? scene.measured : null,
    pinned: shown.pinned ? pinned : null,
  };
}

/** @typedef {ReturnType<typeof listShown>} Shown */

/** Draw what both views show, below and above it what one of them does. @param {Sheet} sheet @param {Shown} seen @param {() => void} [below] @param {() => void} [above] */
function paintCurves(sheet, { state, band, measured, pinned }, below = () => {}, above = () => {}) {
  const { shown } = now;
  sheet.within(view.box, () => {
    paintTissue(sheet);
    if (band) overlay.paintBand(sheet, band, band.step !== state.step);
    below();
    if (pinned) overlay.paintPinned(sheet, pinned);
    needle.paintNeedle(sheet, state);
    if (shown.path) needle.paintPath(sheet, state);
    if (shown.points) needle.paintPoints(sheet, state);
    if (measured) overlay.paintMeasured(sheet, measured);
    above();
  });
}

/** @param {Sheet} sheet @param {Point} size */
function begin(sheet, [width, height]) {
  sheet.path(`M0,0h${width}v${height}h${-width}Z`, { fill: palette.gutter });
  clearLabels();
}

/** Draw the picture on a sheet of a size, px. @param {Sheet} sheet @param {Point} size */
export function paintPicture(sheet, size) {
  const { shown, scene: { plan } } = now;
  const seen = listShown();
  const { state, band, measured, pinned } = seen;
  begin(sheet, size);
  for (const curve of [state, measured, pinned]) if (curve) avoid(placesOf(curve.x, curve.y));
  paintCurves(sheet, seen, () => {
    if (shown.load && !state.faults.length) needle.paintLoad(sheet); // outside the model's limits a force means nothing
    if (shown.plan && plan) overlay.paintPlan(sheet, plan);
  }, () => {
    overlay.paintPrediction(sheet, state);
    if (measured && shown.errors) overlay.paintGaps(sheet, state, measured);
    needle.paintGuides(sheet, state);
    needle.paintBase(sheet, state);
    if (measured || pinned) overlay.nameNeedle(sheet, state);
    if (band) overlay.nameBand(sheet, band);
    if (shown.inset) overlay.paintInset(sheet, state);
  });
  paintAxes(sheet);
}

/** A curve as it is seen from above. @template {{ x: number[]; z?: number[] | null }} C @param {C} curve */
const turn = (curve) => ({ ...curve, y: curve.z ?? curve.x.map(() => 0) });

/** Draw the view from above on a sheet of a size, px: x as in the picture, z at most as large as y there. @param {Sheet} sheet @param {Point} size */
export function paintAbove(sheet, [width, height]) {
  const { state, band, measured, pinned } = listShown();
  begin(sheet, [width, height]);
  const seen = {
    state: { ...turn(state), constraints: turn(state.constraints), tip_path: turn(state.tip_path),
      bevel: { ...state.bevel, side: Math.sin((state.bevel.roll_deg * Math.PI) / 180) < 0 ? -1 : 1 } },
    band: band?.z ? { ...band, ...band.z } : null, measured: measured && turn(measured), pinned: pinned && turn(pinned),
  };
  const heights = [seen.state, seen.measured, seen.pinned].flatMap((curve) => curve?.y ?? []);
  const [low, high] = /** @type {Point} */ (extent([...heights, ...(seen.band ? [...seen.band.low, ...seen.band.high] : []), 0]));
  const box = { ...view.box, top: EDGE, height: height - 2 * EDGE };
  const magnified = Math.min(view.magnified, (box.height - 2 * ROOM) / (view.scale * (high - low || 1)));
  look({ y: (low + high) / 2, box, magnified }, () => {
    paintCurves(sheet, seen, undefined, () => label(sheet, "from above", [box.left + 6, EDGE + 10], { align: "start" }));
    paintFrame(sheet, magnified === 1 ? "z (mm)" : `z (mm), drawn ${brief(magnified, 2)}×`);
  });
}
