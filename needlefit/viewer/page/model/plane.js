/** How well needles of other b and one other modulus fit: the error over a plane of both, and the valley in it. */

import { SessionBatch } from "../../../mechanics/native/needle.js";
import { ALIGN, AXES, mean, readPoints } from "./errors.js";
import { toInputs } from "./inputs.js";
import { toDegrees } from "../quantities.js";

const POINTS = 51; // of a needle that are compared where none was measured
const SPARE = 0.25; // of the noise floor: errors that differ by less are equal
const EQUAL = 0.1; // mm, where no noise is stated
const NEAR = 2; // times the noise floor: a fit that errs more lies in no valley of the needle shown
const RELATED = 0.4; // correlation of b and a modulus from which there is a ridge
const TIED = 0.9999; // correlation of moduli that are one parameter

function covary(one, other) {
  const [middle, centre] = [mean(one), mean(other)];
  return mean(one.map((value, i) => (value - middle) * (other[i] - centre)));
}

const correlate = (one, other) => covary(one, other) / Math.sqrt(covary(one, one) * covary(other, other)) || 0;

/** The draws of a scene as logarithms: of b, or the angle of the cut, and of each modulus, Pa; which modulus is the most correlated with b. */
export function readDraws({ draws, fitted: { layers }, simulation: { model } }) {
  const b = Array.from(draws.strength, (one) => Math.log(model.pathAngle ? toDegrees(one) : one));
  const mu = layers.map((_, layer) => b.map((_, draw) => Math.log(draws.mu[draw * layers.length + layer] * 1e6)));
  const related = mu.map((one) => correlate(b, one));
  const layer = related.indexOf(Math.min(...related)); // more of one for less of the other
  return { b, mu, layer, related: -related[layer] };
}

/** The layers, numbers from 0, whose moduli are one parameter with that of a layer. */
export const findTied = (mu, layer) => mu.map((_, i) => i).filter((i) => i === layer || correlate(mu[i], mu[layer]) > TIED);

/** How b goes with the modulus of a layer in the draws: change of its logarithm by that of the modulus. */
export const findSlope = ({ b, mu, layer }) => covary(b, mu[layer]) / covary(mu[layer], mu[layer]);

/** Whether b and a modulus of the draws replace one another, and the needle of the fit is as near to the one shown as noise lets it be. */
export function hasRidge(needle) {
  const { scene } = needle;
  if (!scene.draws || readDraws(scene).related < RELATED) return false;
  const target = makeTarget(needle);
  return compareWith(target, readPoints(needle.session, target.s)) <= NEAR * (scene.measured?.floor_mm ?? Infinity);
}

/** What needles are compared with: {pose, s, points, axes}, the measured needle, or else the one that stands there. */
export function makeTarget({ scene: { measured }, session }) {
  if (measured && Math.abs(measured.depth_mm - session.shape.depth) < 1e-6) {
    const { pose, s, x, y, z } = measured.target;
    return { pose, s, points: x.map((one, i) => [one, y[i], z[i]]), axes: AXES[measured.compared] };
  }
  const s = Array.from({ length: POINTS }, (_, i) => (session.shape.depth * i) / (POINTS - 1));
  return { pose: "known", s, points: readPoints(session, s), axes: AXES.space };
}

/** The mean distance, mm, of points from those of a target, in the coordinates that are compared: IPE, of a measured needle. */
export function compareWith({ pose, points, axes }, found) {
  return mean(ALIGN[pose](found, points).map((point, i) => Math.hypot(...axes.map((axis) => point[axis] - points[i][axis]))));
}

/** By how much errors of a target may differ and still be equal, mm. */
export const equalWithin = ({ measured }) => (measured?.floor_mm ? SPARE * measured.floor_mm : EQUAL);

/**
 * Resolves to the errors, mm, of needles beside a target: for each modulus a row of strengths, those of the kernel.
 *
 * `factors`, one for each row, multiply the moduli of the layers `tied`, numbers from 0. NaN where there is no needle.
 */
export async function computePlane(kernel, steered, target, { strengths, factors, tied }) {
  const { model, session } = steered;
  const path = steered.path();
  const sets = strengths.flat().length;
  const mu = factors.flatMap((factor, row) => strengths[row].flatMap(() => model.mu.map((one, i) => (tied.includes(i) ? one * factor : one))));
  const values = { sets, mu: Float64Array.from(mu), strength: Float64Array.from(strengths.flat()) };
  values.law = Float64Array.from(Array.from({ length: sets }, () => model.law).flat());
  const { depth } = session.shape;
  const { planes } = session;
  const batch = await SessionBatch.begin(kernel, model, values, path.length + Math.ceil(depth / model.spacing) + 2, planes);
  const s = Float64Array.from(target.s, (one) => Math.min(one, depth));
  const stands = Array.from({ length: sets }, () => true);
  for (const step of path) {
    batch.hold(toInputs(step, model.pathAngle));
    stands.forEach((there, i) => (stands[i] = there && batch.go(i, step.depth)));
  }
  const errors = stands.map((there, i) => {
    if (!there) return NaN;
    const found = batch.positions(i, s);
    const points = target.s.map((_, k) => [0, 1, 2].map((axis) => (axis <= planes ? found[(1 + planes) * k + axis] : 0)));
    return compareWith(target, points);
  });
  return strengths.map((row) => errors.splice(0, row.length));
}

/** Where each row of errors is least: {column, error}, between columns by a parabola; null where that is at an edge. */
export const findValley = (rows) => rows.map((errors) => {
  const least = errors.indexOf(Math.min(...errors.filter((one) => !Number.isNaN(one))));
  const [before, here, after] = [-1, 0, 1].map((by) => errors[least + by]);
  const curl = before - 2 * here + after;
  if (!(curl > 0)) return null;
  const by = (before - after) / (2 * curl);
  return { column: least + by, error: here - (curl * by * by) / 2 };
});

/** Lines of equal error: pairs of places [column, row] where a level lies between neighbours. */
export function findContour(rows, level) {
  const pairs = [];
  for (let row = 0; row + 1 < rows.length; row += 1) {
    for (let column = 0; column + 1 < rows[0].length; column += 1) {
      const corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(([right, up]) => [column + right, row + up]);
      const cuts = corners.flatMap((from, i) => {
        const to = corners[(i + 1) % 4];
        const [one, other] = [from, to].map(([x, y]) => rows[y][x] - level);
        return one < 0 === other < 0 || Number.isNaN(one + other) ? [] : [from.map((at, axis) => at + (one / (one - other)) * (to[axis] - at))];
      });
      for (let i = 0; i + 1 < cuts.length; i += 2) pairs.push([cuts[i], cuts[i + 1]]);
    }
  }
  return pairs;
}
