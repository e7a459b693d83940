/** The band of draws of the parameters: the central 95 % of their needles where a needle stands. */

import { simulateBatch } from "../../../mechanics/native/needle.js";

const POINTS = 51; // from entry to tip
const EDGES = [0.025, 0.975];
const CHUNK = 10; // draws that are simulated before a newer order is looked for

/**
 * Resolves to {x, low, high, failed} from entry to tip, or null where there is no needle to draw or `cancelled()`.
 *
 * draws: {sets, mu, law, strength} of `simulateBatch`; steps [{depth, inputs}] lead to the needle. `pause` resolves
 * once newer orders have come.
 */
export async function computeBand(kernel, model, draws, steps, cancelled, pause) {
  const { depth } = steps.at(-1);
  if (!(depth > 0)) return null;
  const s = Array.from({ length: POINTS }, (_, i) => (i === POINTS - 1 ? depth : (depth * i) / (POINTS - 1)));
  const [xs, ys] = [[], []];
  let failed = 0;
  const kept = {};
  for (let first = 0; first < draws.sets; first += CHUNK) {
    const sets = Math.min(CHUNK, draws.sets - first);
    const part = (values) => values.slice((first * values.length) / draws.sets, ((first + sets) * values.length) / draws.sets);
    const values = { sets, mu: part(draws.mu), law: part(draws.law), strength: part(draws.strength) };
    const { shapes, positions } = await simulateBatch(kernel, model, steps, values, kept);
    shapes.forEach(({ status }, i) => {
      if (status !== "converged") return void (failed += 1);
      const points = positions(i, s);
      xs.push(points.filter((_, k) => k % 2 === 0));
      ys.push(points.filter((_, k) => k % 2 === 1));
    });
    await pause();
    if (cancelled()) return null;
  }
  if (!xs.length) return null;
  const at = (rows, k, share) => quantile(rows.map((row) => row[k]).sort((one, other) => one - other), share);
  return {
    x: s.map((_, k) => at(xs, k, 0.5)),
    low: s.map((_, k) => at(ys, k, EDGES[0])),
    high: s.map((_, k) => at(ys, k, EDGES[1])),
    failed,
  };
}

/** A quantile of sorted values, linear between them. */
function quantile(sorted, share) {
  const place = share * (sorted.length - 1);
  const below = Math.floor(place);
  return sorted[below] + (place - below) * ((sorted[below + 1] ?? sorted[below]) - sorted[below]);
}
