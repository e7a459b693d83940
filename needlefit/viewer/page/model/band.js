/** The simultaneous band of draws of the parameters: 95 % of their needles lie wholly inside, where a needle stands. */

import { SessionBatch } from "../../../mechanics/native/needle.js";

const POINTS = 51; // from entry to tip
const [LOW, MIDDLE, HIGH] = [0.025, 0.5, 0.975]; // pointwise quantiles; the band is scaled by their distances
const LEVEL = 0.95; // share of the needles that lie wholly inside
const TINY = 1e-9; // mm; needles that are as close as this do not spread
const CHUNK = 20; // draws that move before a newer order is looked for
const SAME = 1e-9; // mm; depths that differ by less are one
const BACK = 1e-6; // mm; a needle retracted by that much has left inputs under which it has cut nothing

/** The needles of draws. Each goes on from where it stands, so that a small step costs little. */
export class Band {
  /** draws: {sets, mu, law, strength} in place of the model's. */
  kernel; model; draws; values; chunks; rays; points;
  /** @type {any} */
  batch;

  constructor(kernel, model, draws) {
    const chunks = Array.from({ length: Math.ceil(draws.sets / CHUNK) }, (_, n) => ({
      numbers: Array.from({ length: Math.min(CHUNK, draws.sets - n * CHUNK) }, (_, i) => n * CHUNK + i),
    }));
    const typed = ["mu", "law", "strength"].map((name) => [name, Float64Array.from(draws[name])]);
    const values = { sets: draws.sets, ...Object.fromEntries(typed) };
    Object.assign(this, { kernel, model, draws, values, chunks, rays: 0, points: [] });
  }

  /**
   * Resolves to {x, low, high, failed} from entry to tip, in space with {z: {low, high}}, or null where there is no needle to draw or `cancelled()`.
   *
   * steps [{depth, inputs}] lead to the needle from first contact on, in so many planes. `pause` resolves once newer orders
   * have come.
   */
  async compute(steps, planes, cancelled, pause) {
    const path = mark(steps);
    const { depth } = path.at(-1);
    if (!(depth > 0)) return null;
    const rays = path.length + Math.ceil(depth / this.model.spacing) + 2;
    if (rays > this.rays || planes !== this.batch.planes) {
      this.rays = 2 * rays;
      this.batch = await SessionBatch.begin(this.kernel, this.model, this.values, this.rays, planes);
      for (const chunk of this.chunks) chunk.path = null;
    }
    for (const chunk of this.chunks) {
      this.#move(chunk, path);
      await pause();
      if (cancelled()) return null;
    }
    const found = this.points.filter((one) => one);
    if (!found.length) return null;
    const along = (axis) => Array.from({ length: POINTS }, (_, k) => Float64Array.from(found, (one) => one[(1 + planes) * k + axis]));
    const [y, z] = spanBands(planes > 1 ? [along(1), along(2)] : [along(1)]);
    const x = along(0).map((values) => quantile(values.sort(), MIDDLE));
    return { x, ...y, z: z ?? null, failed: this.values.sets - found.length };
  }

  /** Move some needles to the end of a path. Those that failed there or deeper try again from first contact on. */
  #move(chunk, path) {
    const { batch, points } = this;
    let way = chunk.path && findWay(chunk.path, path);
    if (!way || way[0]?.depth <= chunk.failed) {
      way = path;
      chunk.failed = -Infinity; // depth, mm, where the last one has failed
      for (const i of chunk.numbers) {
        batch.restart(i);
        points[i] = [];
      }
    }
    chunk.path = path;
    const { depth } = path.at(-1);
    const s = Float64Array.from({ length: POINTS }, (_, k) => (k === POINTS - 1 ? depth : (depth * k) / (POINTS - 1)));
    way.forEach((step, n) => {
      batch.hold(step.inputs);
      for (const i of chunk.numbers) {
        if (!points[i]) continue;
        const converged = batch.go(i, step.depth);
        if (!converged) [points[i], chunk.failed] = [null, Math.max(chunk.failed, step.depth)];
        else if (n === way.length - 1) points[i] = batch.positions(i, s);
      }
    });
  }
}

/** Steps with a text that is the same for the same inputs. Each draw has a bevel of its own: that it changes counts. */
function mark(steps) {
  let changes = 0;
  return steps.map(({ depth, inputs }, n) => {
    if (n && inputs.bevel.strength !== steps[n - 1].inputs.bevel.strength) changes += 1;
    const alike = { ...inputs, bevel: { ...inputs.bevel, strength: changes } };
    return { depth, inputs: alike, text: JSON.stringify(alike) };
  });
}

const same = (depth, other) => Math.abs(depth - other) <= SAME;

/** The steps that lead from the end of one path to the end of another; null: first contact has to come first. */
export function findWay(past, path) {
  let shared = 0;
  const alike = (n) => past[n]?.text === path[n]?.text;
  while (shared < past.length && shared < path.length && alike(shared) && same(past[shared].depth, path[shared].depth)) shared += 1;
  const [last, rest] = [past.at(-1), path.slice(shared)];
  const left = past.length - shared; // steps that the path does not have
  const begun = left > 0 && rest.length > 0 && alike(shared); // the next one has the same inputs, and ends elsewhere
  const turned = shared > 0 && rest.length > 0 && same(last.depth, path[shared - 1].depth); // inputs changed, nothing was cut
  if (left === 0 || (begun && left === 1) || (!begun && turned)) return rest;
  const from = begun ? shared : shared - 1;
  if (from < 0) return null;
  const depth = (begun ? Math.min(past[shared].depth, path[shared].depth) : path[from].depth) - BACK;
  return depth > 0 ? [{ ...path[from], depth }, ...path.slice(from)] : null;
}

/** The ends {low, high} of the band in each plane, from heights[plane][point][draw]: as needlefit.inference.curve_bands. */
function spanBands(planes) {
  const sizes = new Float64Array(planes[0][0].length); // the factor that holds each needle
  const scaled = planes.map((heights) => heights.map((values) => {
    const sorted = values.slice().sort();
    const [low, middle, high] = [LOW, MIDDLE, HIGH].map((share) => quantile(sorted, share));
    values.forEach((value, i) => {
      const scale = value < middle ? middle - low : high - middle;
      if (scale > TINY) sizes[i] = Math.max(sizes[i], Math.abs(value - middle) / scale);
    });
    return [middle, middle - low, high - middle];
  }));
  const size = sizes.sort()[Math.min(Math.floor(LEVEL * sizes.length), sizes.length - 1)];
  return scaled.map((points) => ({
    low: points.map(([middle, below]) => middle - size * below),
    high: points.map(([middle, , above]) => middle + size * above),
  }));
}

/** A quantile of sorted values, linear between them. */
function quantile(sorted, share) {
  const place = share * (sorted.length - 1);
  const below = Math.floor(place);
  return sorted[below] + (place - below) * ((sorted[below + 1] ?? sorted[below]) - sorted[below]);
}
