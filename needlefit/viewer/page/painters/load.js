/** What the tissue puts on the shaft, N/mm: a filled curve beside the needle, with a scale of its own. */

import { brief, roundStep } from "../numbers.js";
import { palette } from "../palette.js";
import { toPx, toPy, view } from "../view.js";
import { thickness } from "./needle.js";
import { label } from "./strokes.js";

const TALLEST = 64; // px
const LOWEST = 18; // px
const LEAST = 1e-6; // N/mm; less is drawn as nothing

let perNewton = null; // px per N/mm

/** Draw the load normal to the shaft, toward the side to which it pushes. */
export function paintLoad(context, { load: { x, y, n_per_mm: load } }) {
  const greatest = load.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
  if (greatest < LEAST || x.length < 2) return;
  rescale(greatest);
  const [px, py] = [x.map(toPx), y.map(toPy)];
  const end = ends(px, py, load);
  context.beginPath();
  context.moveTo(px[0], py[0]);
  for (const [ex, ey] of end) context.lineTo(ex, ey);
  for (let i = px.length - 1; i >= 0; i -= 1) context.lineTo(px[i], py[i]);
  context.fillStyle = palette.load;
  context.globalAlpha = 0.32;
  context.fill();
  context.globalAlpha = 1;
  context.beginPath();
  for (const [ex, ey] of end) context.lineTo(ex, ey);
  context.strokeStyle = palette.load;
  context.lineWidth = 1.5;
  context.stroke();
  paintKey(context);
}

/** Where the load's ends are drawn, px: along the shaft's normal, from its surface on. */
function ends(px, py, load) {
  const [last, surface] = [px.length - 1, thickness() / 2];
  return px.map((_, i) => {
    const [before, after] = [Math.max(i - 1, 0), Math.min(i + 1, last)];
    const [dx, dy] = [px[after] - px[before], py[after] - py[before]];
    const size = (load[i] * perNewton + Math.sign(load[i]) * surface) / (Math.hypot(dx, dy) || 1);
    return [px[i] + dy * size, py[i] - dx * size];
  });
}

/** Keep the scale while the curve is neither too tall nor too low: a load that grows shall look so. */
function rescale(greatest) {
  const height = greatest * (perNewton ?? 0);
  if (height > TALLEST || height < LOWEST) perNewton = (0.75 * TALLEST) / (2 * roundStep(greatest));
}

/** The length of a round load, at the upper left. */
function paintKey(context) {
  const size = roundStep(40 / perNewton);
  const [px, py] = [view.box.left + 14, view.box.top + 14];
  context.fillStyle = palette.load;
  context.fillRect(px, py, 2, size * perNewton);
  context.fillRect(px - 3, py, 8, 1.5);
  context.fillRect(px - 3, py + size * perNewton - 1.5, 8, 1.5);
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "left";
  context.textBaseline = "middle";
  label(context, `${brief(size)} N/mm`, px + 10, py + (size * perNewton) / 2);
}
