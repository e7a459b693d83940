/** The axes in mm, and a scale bar. */

import { palette } from "../palette.js";
import { brief, roundStep } from "../numbers.js";
import { fromPx, fromPy, toPx, toPy, view } from "../view.js";
import { label } from "./strokes.js";

const FONT = "11px system-ui, sans-serif";
const TICK = 5; // px
const APART = 48; // px between ticks, at least, where there is room for so few

/** Draw ticks and names outside the box, and the scale bar inside. */
export function paintAxes(context) {
  const { left, top, width, height } = view.box;
  context.strokeStyle = palette.quiet;
  context.lineWidth = 1;
  context.strokeRect(left - 0.5, top - 0.5, width + 1, height + 1);
  context.font = FONT;
  context.fillStyle = palette.label;
  paintAlong(context);
  paintAcross(context);
  paintScaleBar(context);
}

/** The step of ticks along so many px, at a scale in px per mm; it is rounded down, by 2.5 at most. */
const stepAt = (scale, length) => roundStep((2.5 * Math.min(APART, length / 6)) / scale);

function ticks(low, high, step) {
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.max(Math.floor(high / step) - first + 1, 0) }, (_, i) => (first + i) * step);
}

const written = (value) => brief(value, 6).replace("-", "−");

function paintAlong(context) {
  const { left, top, width, height } = view.box;
  const bottom = top + height;
  context.textAlign = "center";
  context.textBaseline = "top";
  context.beginPath();
  for (const x of ticks(fromPx(left), fromPx(left + width), stepAt(view.scale, width))) {
    const px = Math.round(toPx(x)) + 0.5;
    context.moveTo(px, bottom);
    context.lineTo(px, bottom + TICK);
    context.fillText(written(x), px, bottom + TICK + 2);
  }
  context.stroke();
  context.textBaseline = "bottom";
  context.fillText("x along the entry (mm)", left + width / 2, bottom + 37);
}

function paintAcross(context) {
  const { left, top, height } = view.box;
  const scale = view.scale * view.magnified;
  context.textAlign = "right";
  context.textBaseline = "middle";
  context.beginPath();
  for (const y of ticks(fromPy(top + height), fromPy(top), stepAt(scale, height))) {
    const py = Math.round(toPy(y)) + 0.5;
    context.moveTo(left - TICK, py);
    context.lineTo(left, py);
    context.fillText(written(y), left - TICK - 2, py);
  }
  context.stroke();
  context.save();
  context.translate(11, top + height / 2);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.fillText(nameAcross(context, height), 0, 0);
  context.restore();
}

/** What stands along the axis, as long as there is room for. */
function nameAcross(context, room) {
  if (view.magnified === 1) return "y (mm)";
  const long = `y (mm), drawn ${view.magnified}× as large as x`;
  return context.measureText(long).width < room ? long : `y (mm), drawn ${view.magnified}×`;
}

/** A bar of a round length at the lower right; magnified, it holds along x alone. */
function paintScaleBar(context) {
  const { left, top, width, height } = view.box;
  const length = roundStep((0.2 * width) / view.scale);
  const [right, py] = [left + width - 14, top + height - 14];
  const start = right - length * view.scale;
  context.fillStyle = palette.ink;
  context.fillRect(start, py, right - start, 2);
  context.fillRect(start, py - 4, 1.5, 6);
  context.fillRect(right - 1.5, py - 4, 1.5, 6);
  context.textAlign = "center";
  context.textBaseline = "bottom";
  const text = `${brief(length)} mm${view.magnified === 1 ? "" : " along x"}`;
  const middle = Math.min((start + right) / 2, right + 8 - context.measureText(text).width / 2);
  label(context, text, middle, py - 5);
}
