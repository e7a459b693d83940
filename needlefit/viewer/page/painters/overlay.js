/** What the needle is compared with: the measured curve, and the fitted needle's 95 % band. */

import { points } from "../measured_points.js";
import { palette } from "../palette.js";
import { toPx, toPy, view } from "../view.js";
import { thickness } from "./needle.js";
import { label, line, ring } from "./strokes.js";

const GAPS = 12; // parts of the shaft between which gaps are drawn
const MARGIN = 40; // px, half of what is written beside the tip

/** Draw the measured needle, over a halo that sets it off from the needle and from a scan. */
export function paintMeasured(context, { x, y }) {
  context.lineCap = "round";
  line(context, x, y, palette.halo, 4);
  line(context, x, y, palette.measured, 2, [7, 4]);
  context.lineCap = "butt";
}

/** Draw the points of the measured needle that can be dragged. */
export function paintPoints(context) {
  if (!points.shown) return;
  for (const [x, y] of points.places()) ring(context, toPx(x), toPy(y), 6, palette.measured, palette.air);
}

/** Draw the band; pale as long as it belongs to an earlier step. */
export function paintBand(context, { x, low, high }, pale) {
  context.beginPath();
  for (let i = 0; i < x.length; i += 1) context.lineTo(toPx(x[i]), toPy(low[i]));
  for (let i = x.length - 1; i >= 0; i -= 1) context.lineTo(toPx(x[i]), toPy(high[i]));
  context.closePath();
  context.globalAlpha = pale ? 0.1 : 0.22;
  context.fillStyle = palette.band;
  context.fill();
  context.globalAlpha = pale ? 0.4 : 1;
  for (const edge of [low, high]) line(context, x, edge, palette.band, 1.5, [3, 2]);
  context.globalAlpha = 1;
}

/** Draw what the errors are: the gap at the tip (TE), and gaps along the shaft, whose mean is the IPE. */
export function paintGaps(context, state, measured) {
  const { errors, tip } = state;
  if (!errors) return;
  const reach = Math.min(tip.x, measured.x.at(-1));
  context.strokeStyle = palette.gap;
  context.lineWidth = 1.25;
  context.beginPath();
  for (let n = 1; n < GAPS; n += 1) {
    const x = (reach * n) / GAPS;
    context.moveTo(toPx(x), toPy(heightAt(state, x)));
    context.lineTo(toPx(x), toPy(heightAt(measured, x)));
  }
  context.stroke();
  const [x, y] = errors.whole ? [measured.x.at(-1), measured.y.at(-1)] : [reach, heightAt(measured, reach)];
  const end = errors.whole ? [tip.x, tip.y] : [reach, heightAt(state, reach)];
  line(context, [x, end[0]], [y, end[1]], palette.halo, 5);
  line(context, [x, end[0]], [y, end[1]], palette.gap, 2.5);
  context.font = "600 12px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  const { left, width } = view.box;
  const px = Math.min(Math.max(toPx(x), left + MARGIN), left + width - MARGIN);
  const [top, bottom] = [toPy(y), toPy(end[1])].sort((one, other) => one - other);
  const away = thickness() / 2 + 14; // beside the needle, opposite to the bevel's arrow
  label(context, `TE ${errors.te_mm.toFixed(2)} mm`, px, state.bevel.side > 0 ? bottom + away : top - away, palette.gap);
}

/** The y of a curve at x, its points joined by straight lines. */
function heightAt({ x: xs, y: ys }, x) {
  const after = xs.findIndex((one) => one >= x);
  if (after <= 0) return after === 0 ? ys[0] : ys.at(-1);
  const share = (x - xs[after - 1]) / (xs[after] - xs[after - 1]);
  return ys[after - 1] + share * (ys[after] - ys[after - 1]);
}
