/** What the needle is compared with: the measured curve, and the fitted needle's 95 % band. */

import { palette } from "../palette.js";
import { toPx, toPy } from "../view.js";
import { line } from "./strokes.js";

/** Draw the measured needle, over a halo that sets it off from the needle and from a scan. */
export function paintMeasured(context, { x, y }) {
  context.lineCap = "round";
  line(context, x, y, palette.halo, 4);
  line(context, x, y, palette.measured, 2, [7, 4]);
  context.lineCap = "butt";
}

/** Draw the band; pale as long as it belongs to an earlier step. */
export function paintBand(context, { x, low, high }, pale) {
  context.beginPath();
  for (let i = 0; i < x.length; i += 1) context.lineTo(toPx(x[i]), toPy(low[i]));
  for (let i = x.length - 1; i >= 0; i -= 1) context.lineTo(toPx(x[i]), toPy(high[i]));
  context.closePath();
  context.globalAlpha = pale ? 0.2 : 0.5;
  context.fillStyle = palette.band;
  context.fill();
  context.globalAlpha = 1;
}
