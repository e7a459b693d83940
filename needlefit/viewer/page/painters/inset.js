/** What the picture itself does not show: the needle at true scale, and where the tip is when it is outside. */

import { palette } from "../palette.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { label } from "./strokes.js";

const [WIDTH, HEIGHT, EDGE] = [170, 46, 10]; // px
const ARROW = 11; // px

/** Draw the inserted part of the needle with y as large as x, in the lower left. */
export function paintInset(context, { x, y }) {
  const { left, top, height } = view.box;
  const [px, py] = [left + EDGE, top + height - HEIGHT - EDGE];
  context.fillStyle = palette.air;
  context.strokeStyle = palette.quiet;
  context.lineWidth = 1;
  context.fillRect(px, py, WIDTH, HEIGHT);
  context.strokeRect(px + 0.5, py + 0.5, WIDTH - 1, HEIGHT - 1);
  const depth = Math.max(now.scene.depth_mm, now.state.depth_mm, 1);
  const scale = (WIDTH - 2 * EDGE) / depth;
  context.strokeStyle = palette.needle;
  context.lineWidth = 1.5;
  context.beginPath();
  x.forEach((one, i) => one >= 0 && context.lineTo(px + EDGE + one * scale, py + HEIGHT / 2 + 6 - y[i] * scale));
  context.stroke();
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "left";
  context.textBaseline = "top";
  label(context, "true scale", px + 6, py + 4);
}

/** Draw at the edge of the window where the tip is. */
export function paintArrow(context, { tip }) {
  const { left, top, width, height } = view.box;
  const [middle, centre] = [left + width / 2, top + height / 2];
  const angle = Math.atan2(toPy(tip.y) - centre, toPx(tip.x) - middle);
  const reach = Math.min(
    (width / 2 - 2 * ARROW) / Math.max(Math.abs(Math.cos(angle)), 1e-9),
    (height / 2 - 2 * ARROW) / Math.max(Math.abs(Math.sin(angle)), 1e-9),
  );
  context.save();
  context.translate(middle + reach * Math.cos(angle), centre + reach * Math.sin(angle));
  context.rotate(angle);
  context.fillStyle = palette.tip;
  context.beginPath();
  context.moveTo(ARROW, 0);
  context.lineTo(-ARROW, ARROW * 0.8);
  context.lineTo(-ARROW, -ARROW * 0.8);
  context.fill();
  context.restore();
}
