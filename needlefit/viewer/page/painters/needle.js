/** The needle in its true diameter, its bevel, its tip path and its constraint points. */

import { bevelPlace } from "../handles.js";
import { palette } from "../palette.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { line, ring, straight, turned } from "./strokes.js";

const THINNEST = 2; // px
const CROSS = { of: 0.28, least: 1, most: 3.2 }; // half a cross: part of the spacing, px
const LONGEST_BEVEL = 2.5; // diameters
const WIDE = 7; // px; from here on the body is drawn faint
const FAINT = 0.24; // opacity
const AXIS = 2; // px

/** How thick the needle is drawn, px. */
export const thickness = () => Math.max(now.scene.diameter_mm * view.scale, THINNEST);

/**
 * Draw the shaft and the bevel, whose point lies where it turns the cut to.
 *
 * The shaft is its centreline with its body faint behind: what it is compared with is thinner than the body.
 */
export function paintNeedle(context, { x, y, bevel, faults }) {
  const outside = faults?.length > 0; // of the model: it looks different
  const colour = outside ? palette.bad : palette.needle;
  const width = thickness();
  const shaft = shortened(x.map(toPx), y.map(toPy), LONGEST_BEVEL * Math.max(width, 3));
  const axis = new Path2D();
  for (const [px, py] of shaft.points) axis.lineTo(px, py);
  context.lineJoin = "round";
  context.lineCap = "butt";
  if (width >= WIDE) {
    context.globalAlpha = FAINT;
    stroke(context, axis, colour, width);
    context.globalAlpha = 1;
  }
  context.setLineDash(outside ? [9, 5] : []);
  stroke(context, axis, colour, width < WIDE ? width : AXIS);
  context.setLineDash([]);
  paintBevel(context, shaft, Math.max(width, 3) / 2, bevel.side);
}

function stroke(context, path, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke(path);
}

/** The needle's points (px) without its last `length` px, and its tip. */
function shortened(px, py, length) {
  const tip = [px.at(-1), py.at(-1)];
  const far = ([x, y]) => Math.hypot(x - tip[0], y - tip[1]) > length;
  const points = px.map((one, i) => [one, py[i]]).filter(far);
  const [x, y] = points.at(-1) ?? tip;
  const share = 1 - length / (Math.hypot(x - tip[0], y - tip[1]) || 1);
  points.push([x + share * (tip[0] - x), y + share * (tip[1] - y)]);
  return { points, tip };
}

/** The cut face is drawn as a line of its own: it looks away from the side of the point. */
function paintBevel(context, { points, tip }, half, side) {
  const [x, y] = points.at(-1);
  const size = Math.hypot(tip[0] - x, tip[1] - y) || 1;
  const [dx, dy] = [(tip[0] - x) / size, (tip[1] - y) / size];
  const at = ([px, py], to) => [px + to * dy * half, py - to * dx * half]; // canvas y runs downwards
  const [back, near, point] = [at([x, y], -side), at([x, y], side), at(tip, side)];
  context.fillStyle = palette.needle;
  context.beginPath();
  for (const corner of [back, near, point]) context.lineTo(...corner);
  context.fill();
  straight(context, back, point, palette.tip, 2);
}

/** Draw to which side the bevel turns the cut, and whether the tip is held. */
export function paintTip(context, state) {
  const { tip, turn, angle } = bevelPlace(state);
  straight(context, tip, turn, palette.tip, 1);
  turned(context, ...turn, angle, () => paintTurn(context, -state.bevel.side)); // canvas y runs downwards
  if (state.tip.held) ring(context, ...tip, 11, palette.tip, "transparent");
}

/** An arrow head toward the side to which the bevel turns the cut. */
function paintTurn(context, to) {
  context.beginPath();
  context.moveTo(-6, -3 * to);
  context.lineTo(0, 6 * to);
  context.lineTo(6, -3 * to);
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
  const half = Math.min(Math.max(CROSS.of * now.scene.spacing_mm * view.scale, CROSS.least), CROSS.most);
  context.strokeStyle = palette.points;
  context.lineWidth = half > 2 ? 1.4 : 1;
  context.beginPath();
  for (let i = 0; i < x.length; i += 1) {
    const [px, py] = [toPx(x[i]), toPy(y[i])];
    context.moveTo(px - half, py - half);
    context.lineTo(px + half, py + half);
    context.moveTo(px - half, py + half);
    context.lineTo(px + half, py - half);
  }
  context.stroke();
}
