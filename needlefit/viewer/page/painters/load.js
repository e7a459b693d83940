/** What the tissue puts on the shaft, N/mm: a filled curve beside the needle, with a scale of its own. */

import { brief, roundStep } from "../numbers.js";
import { palette } from "../palette.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { thickness } from "./needle.js";
import { label } from "./strokes.js";

const TALLEST = 64; // px
const LOWEST = 18; // px
const LEAST = 1e-6; // N/mm; less is drawn as nothing

let perNewton = null; // px per N/mm

/**
 * Draw the load normal to the shaft, on the side to which it pushes.
 *
 * Between constraint points the load of the model is a sawtooth; its mean over two spacings is what the
 * tissue means to the shaft. `raw` draws the load itself.
 */
export function paintLoad(context, { load: { x, y, n_per_mm: values } }, raw) {
  const load = raw ? values : smooth(x, values, now.scene.spacing_mm);
  const greatest = load.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
  if (greatest < LEAST || x.length < 2) return;
  rescale(greatest);
  const [px, py] = [x.map(toPx), y.map(toPy)];
  const surface = beside(px, py, load, 0);
  const ends = beside(px, py, load, perNewton);
  const [areas, edges] = [new Path2D(), new Path2D()];
  for (const [from, to] of runs(load)) {
    const curve = [surface[from], ...ends.slice(from, to), surface[to - 1]];
    curve.forEach((place, i) => (i ? edges.lineTo(...place) : edges.moveTo(...place)));
    curve.push(...surface.slice(from, to).reverse());
    curve.forEach((place, i) => (i ? areas.lineTo(...place) : areas.moveTo(...place)));
  }
  context.fillStyle = context.strokeStyle = palette.load;
  context.globalAlpha = 0.32;
  context.fill(areas);
  context.globalAlpha = 1;
  context.lineWidth = 1.25;
  context.stroke(edges);
  paintKey(context);
}

/** The mean of a load over so many mm to either side of each of its places; less at the ends. */
export function smooth(x, load, reach) {
  const sums = [0]; // of the load up to each place, trapezia
  for (let i = 1; i < x.length; i += 1) sums.push(sums[i - 1] + ((load[i] + load[i - 1]) / 2) * (x[i] - x[i - 1]));
  const sumTo = (at, i) => { // i: the first place beyond `at`
    if (i === 0) return 0;
    if (i === x.length) return sums.at(-1);
    const part = (at - x[i - 1]) / (x[i] - x[i - 1] || 1);
    return sums[i - 1] + (load[i - 1] + (part * (load[i] - load[i - 1])) / 2) * (at - x[i - 1]);
  };
  let [from, to] = [0, 0];
  return x.map((at) => {
    const half = Math.min(reach, at - x[0], x.at(-1) - at);
    if (half <= 0) return load[at === x[0] ? 0 : x.length - 1];
    while (from < x.length && x[from] <= at - half) from += 1;
    while (to < x.length && x[to] <= at + half) to += 1;
    return (sumTo(at + half, to) - sumTo(at - half, from)) / (2 * half);
  });
}

/** Where the load pushes to one side without a break: first point, and one behind the last. */
function runs(load) {
  const starts = load.map((_, i) => i).filter((i) => i === 0 || load[i] * load[i - 1] <= 0);
  return starts.map((from, n) => [from, starts[n + 1] ?? load.length]);
}

/** Places beside the shaft, px: on its normal, as far from the surface that is pushed as the load is great. */
function beside(px, py, load, scale) {
  const [last, surface] = [px.length - 1, thickness() / 2];
  return px.map((_, i) => {
    const [before, after] = [Math.max(i - 1, 0), Math.min(i + 1, last)];
    const [dx, dy] = [px[after] - px[before], py[after] - py[before]];
    const size = (load[i] * scale + Math.sign(load[i]) * surface) / (Math.hypot(dx, dy) || 1);
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
