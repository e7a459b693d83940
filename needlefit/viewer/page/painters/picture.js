/** The picture from the side, and of a needle in space from above, with z in place of y: the same painters, the same layers. */

import { extent } from "d3-array";
import { brief, predictionOf } from "../quantities.js";
import { path, text, traceBox, within } from "../sheet.js";
import { now } from "../store.js";
import { look, view } from "../view.js";
import { paintAxes, paintFrame, paintTissue } from "./background.js";
import * as needle from "./needle.js";
import * as overlay from "./overlay.js";
import { avoid, clearLabels, placesOf } from "./strokes.js";

const [EDGE, ROOM] = [8, 14]; // px above and below the window of the view from above, and in it

/** Whether something is seen from above: a needle in space, or one that is compared there. */
export const isSpatial = () => Boolean(now.state?.z ?? now.scene?.measured?.compared === "space");

/** What is shown and known; the band may be of a place that the needle has left. */
function listShown() {
  const { state, shown, scene, band, pinned } = now;
  return {
    state,
    band: shown.band && band && overlay.isBandNear(band, state) ? band : null,
    measured: shown.measured ? scene.measured : null,
    pinned: shown.pinned ? pinned : null,
  };
}

/** Draw what both views show, below and above it what one of them does. @param {ReturnType<typeof listShown>} seen @param {() => void} below @param {() => void} above */
function paintCurves({ state, band, measured, pinned }, below, above) {
  const { shown } = now;
  within(view.box, () => {
    paintTissue();
    if (band) overlay.paintBand(band, band.step !== state.step);
    below();
    if (pinned) overlay.paintCompared("pinned", pinned, "pinned", 2.5, [2, 3]);
    needle.paintNeedle(state);
    if (shown.path) needle.paintPath(state);
    if (shown.points) needle.paintPoints(state);
    if (measured) overlay.paintCompared("measured", measured, "measured", 2, [7, 4]);
    if (measured?.tip) overlay.paintCompared("measured", measured.tip, "measured", 2);
    above();
  });
}

/** @param {Point} size */
function begin([width, height]) {
  path(traceBox({ left: 0, top: 0, width, height }), { fill: "gutter" });
  clearLabels();
}

/** Draw the picture, of a size, px. @param {Point} size */
export function paintPicture(size) {
  const { shown, scene } = now;
  const { plan } = scene;
  const prediction = predictionOf(now.state, scene);
  const seen = listShown();
  const { state, band, measured, pinned } = seen;
  begin(size);
  for (const curve of [state, measured, pinned]) if (curve) avoid(placesOf(curve));
  paintCurves(seen, () => {
    if (shown.load && !state.faults.length) needle.paintLoad(); // outside the model's limits a force means nothing
    if (shown.plan && plan) overlay.paintPlan(plan);
  }, () => {
    if (prediction) overlay.paintCompared("predicted", prediction, "accent", 2.5);
    if (measured && shown.errors) overlay.paintGaps(state, measured);
    needle.paintGuides(state);
    needle.paintBase(state);
    if (measured || pinned) overlay.nameNeedle(state);
    if (band) overlay.nameBand(band);
    if (shown.inset) overlay.paintInset(state);
  });
  paintAxes();
}

/** A curve as it is seen from above. @template {{ x: number[]; z?: number[] | null }} C @param {C} curve */
const turn = (curve) => ({ ...curve, y: curve.z ?? curve.x.map(() => 0) });

/** Draw the view from above, of a size, px: x as in the picture, z at most as large as y there. @param {Point} size */
export function paintAbove([width, height]) {
  const { state, band, measured, pinned } = listShown();
  begin([width, height]);
  const seen = {
    state: { ...turn(state), constraints: turn(state.constraints), tip_path: turn(state.tip_path),
      bevel: { ...state.bevel, side: Math.sin((state.bevel.roll_deg * Math.PI) / 180) < 0 ? -1 : 1 } },
    band: band?.z ? { ...band, ...band.z } : null, measured: measured && { ...turn(measured), tip: measured.tip && turn(measured.tip) }, pinned: pinned && turn(pinned),
  };
  const heights = [seen.state, seen.measured, seen.pinned].flatMap((curve) => curve?.y ?? []);
  const [low, high] = /** @type {Point} */ (extent([...heights, ...(seen.band ? [...seen.band.low, ...seen.band.high] : []), 0]));
  const box = { ...view.box, top: EDGE, height: height - 2 * EDGE };
  const magnified = Math.min(view.magnified, (box.height - 2 * ROOM) / (view.scale * (high - low || 1)));
  look({ y: (low + high) / 2, box, magnified }, () => {
    paintCurves(seen, () => {}, () => text("from above", [box.left + 6, EDGE + 10], { align: "start", halo: true }));
    paintFrame(magnified === 1 ? "z (mm)" : `z (mm), drawn ${brief(magnified, 2)}×`);
  });
}
