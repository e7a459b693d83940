/** Lines and shapes on the canvas, given in mm. */

import { palette } from "../palette.js";
import { toPx, toPy } from "../view.js";

/** Begin a path along points (x, y). */
export function trace(context, x, y) {
  context.beginPath();
  for (let i = 0; i < x.length; i += 1) context.lineTo(toPx(x[i]), toPy(y[i]));
}

/** Draw a line along points. */
export function line(context, x, y, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  trace(context, x, y);
  context.stroke();
  context.setLineDash([]);
}

/** Draw a ring with a filled inside, as handles have it. */
export function ring(context, px, py, radius, edge, inside) {
  context.beginPath();
  context.arc(px, py, radius, 0, 2 * Math.PI);
  context.fillStyle = inside;
  context.fill();
  context.strokeStyle = edge;
  context.lineWidth = 2;
  context.stroke();
}

/** Draw a straight line between two places in px. */
export function straight(context, [fromX, fromY], [toX, toY], colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(fromX, fromY);
  context.lineTo(toX, toY);
  context.stroke();
}

/** Carry out drawing with the origin at a place in px, x along a direction (rad, counterclockwise). */
export function turned(context, px, py, angle, draw) {
  context.save();
  context.translate(px, py);
  context.rotate(-angle);
  draw();
  context.restore();
}

/** Write on the picture, set off from what lies behind. */
export function label(context, text, px, py, colour = palette.label) {
  context.strokeStyle = palette.halo;
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeText(text, px, py);
  context.fillStyle = colour;
  context.fillText(text, px, py);
}
