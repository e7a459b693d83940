/** The needle in its true diameter, its bevel, its tip path and its constraint points. */

import { palette } from "../palette.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { line, ring, turned } from "./strokes.js";

const THINNEST = 2; // px
const CROSS = 3; // px
const LONGEST_BEVEL = 3; // diameters

/** How thick the needle is drawn, px. */
export const thickness = () => Math.max(now.scene.diameter_mm * view.scale, THINNEST);

/** Draw the shaft as a tube with a light core, up to where the bevel begins. */
export function paintNeedle(context, { x, y }) {
  const width = thickness();
  context.lineJoin = "round";
  context.lineCap = "butt";
  line(context, x, y, palette.needle, width);
  if (width > 5) line(context, x, y, palette.core, 0.35 * width);
}

/** Draw the tip: its point lies on the side to which the bevel turns the cut, its face looks to the other. */
export function paintTip(context, { tip, bevel }) {
  const half = Math.max(thickness() / 2, 2);
  const length = 2 * LONGEST_BEVEL * half;
  const [px, py] = [toPx(tip.x), toPy(tip.y)];
  turned(context, px, py, Math.atan(tip.slope * view.magnified), () => {
    const up = -bevel.side; // canvas y runs downwards
    context.beginPath();
    context.moveTo(-length, -up * half);
    context.lineTo(0, up * half);
    context.lineTo(1, up * half);
    context.lineTo(1, -up * (half + 1));
    context.lineTo(-length, -up * (half + 1));
    context.closePath();
    context.fillStyle = palette.soft;
    context.fill();
    context.beginPath();
    context.moveTo(-length, -up * half);
    context.lineTo(0, up * half);
    context.strokeStyle = palette.tip;
    context.lineWidth = 2;
    context.stroke();
    paintTurn(context, up * (half + 9));
  });
  if (tip.held) ring(context, px, py, 11, palette.tip, "transparent");
}

/** An arrow head that says to which side the bevel turns the cut. */
function paintTurn(context, py) {
  const to = Math.sign(py);
  context.beginPath();
  context.moveTo(-5, py);
  context.lineTo(0, py + 6 * to);
  context.lineTo(5, py);
  context.closePath();
  context.fillStyle = palette.tip;
  context.fill();
}

/** Draw where the tip has been. */
export function paintPath(context, { tip_path: [x, y] }) {
  line(context, x, y, palette.path, 1.5);
}

/** Draw the points that hold the needle in the tissue, as crosses. */
export function paintPoints(context, { constraints: [x, y] }) {
  context.strokeStyle = palette.points;
  context.lineWidth = 1.4;
  context.beginPath();
  for (let i = 0; i < x.length; i += 1) {
    const [px, py] = [toPx(x[i]), toPy(y[i])];
    context.moveTo(px - CROSS, py - CROSS);
    context.lineTo(px + CROSS, py + CROSS);
    context.moveTo(px - CROSS, py + CROSS);
    context.lineTo(px + CROSS, py - CROSS);
  }
  context.stroke();
}
