/** The simultaneous band of draws: 95 % of their needles lie wholly inside. */

import { Session } from "../../../mechanics/native/needle.js";

const POINTS = 51; // from entry to tip
const [LOW, MIDDLE, HIGH] = [0.025, 0.5, 0.975]; // pointwise quantiles; the band is scaled by their distances
const LEVEL = 0.95; // share of the needles that lie wholly inside
const TINY = 1e-9; // mm; needles that are as close as this do not spread

/**
 * {x, low, high, failed} from entry to tip, in space with {z: {low, high}}, or null where there is no needle to draw.
 *
 * Each of the `draws` {sets, mu, law, strength, gain} takes the place of what the session's model and the steps have; of each move of
 * the base the part `gain` reaches the needle.
 *
 * @param {Session} session @param {Draws} draws @param {Reached[]} steps
 */
export function computeBand(session, draws, steps) {
  const { depth } = steps[steps.length - 1];
  if (!(depth > 0)) return null;
  const s = Array.from({ length: POINTS }, (_, k) => (k === POINTS - 1 ? depth : (depth * k) / (POINTS - 1)));
  const needles = /** @type {Float64Array[]} */ ([]);
  const { y, slope } = steps[0].inputs.base;
  for (let n = 0; n < draws.sets; n += 1) {
    /** @param {number[]} values */
    const part = (values) => values.slice((n * values.length) / draws.sets, ((n + 1) * values.length) / draws.sets);
    const gain = draws.gain?.[n] ?? 1;
    const path = steps.map(({ depth, inputs: { bevel, base, ...held } }) => ({
      depth, inputs: {
        ...held, bevel: { ...bevel, strength: draws.strength[n] },
        base: { ...base, y: y + gain * (base.y - y), slope: slope + gain * (base.slope - slope) },
      },
    }));
    if (session.again({ ...session.model, mu: part(draws.mu), law: part(draws.law) }, path)) needles.push(session.positions(s));
  }
  if (!needles.length) return null;
  const { planes } = session;
  /** @param {number} axis */
  const along = (axis) => Array.from({ length: POINTS }, (_, k) => Float64Array.from(needles, (points) => points[(1 + planes) * k + axis]));
  const [across, z = null] = spanBands(planes > 1 ? [along(1), along(2)] : [along(1)]);
  const x = along(0).map((values) => quantile(values.sort(), MIDDLE));
  return { x, ...across, z, failed: draws.sets - needles.length };
}

/** The ends {low, high} of the band in each plane, from heights[plane][point][draw]: as needlefit.inference.curve_bands. @param {Float64Array[][]} planes */
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

/** A quantile of sorted values, linear between them. @param {Float64Array} sorted @param {number} share */
function quantile(sorted, share) {
  const place = share * (sorted.length - 1);
  const below = Math.floor(place);
  return sorted[below] + (place - below) * ((sorted[below + 1] ?? sorted[below]) - sorted[below]);
}
