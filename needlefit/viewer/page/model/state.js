/** What the page shows of a simulated needle: places in mm, rotations in rad. */

import { rollOf, wrap } from "./bevel.js";
import { guideNumber } from "./inputs.js";
import { computeErrors } from "./errors.js";
import { computeValidity, listFaults, listGaps } from "./validity.js";

const POINTS_BEFORE_TISSUE = 25; // of the needle that are drawn
const SAMPLES = 8; // of the load between two constraint points, where it is a sawtooth

/** The columns of points that stand one after the other. @param {ArrayLike<number>} points @param {number} width */
const columns = (points, width) =>
  Array.from({ length: width }, (_, axis) => Array.from({ length: points.length / width }, (_, i) => points[width * i + axis]));

/** All that changes from step to step; `z` is of a needle in space. @param {SteeredNeedle} steered @returns {State} */
export function describeState(steered) {
  const { scene, session, model, names, rules } = steered;
  const { shape, depth, inputs: { bevel, base, guides, tip } } = session;
  const validity = computeValidity(shape, model);
  const [x, y, z = null] = columns(session.positions(listStations(shape)), 1 + shape.planes);
  const last = shape.x.length - 1;
  const roll = wrap(rollOf(bevel));
  return {
    step: steered.number,
    depth_mm: depth,
    x, y, z, ...placePoints(session),
    base: { x: x[0], y: y[0], rotation: shape.slope[0], input_y: base.y, input_slope: base.slope },
    guides: guides.map(({ name, x, y, slope }) => ({
      item: guideNumber(name, names), name, x, y, slope: slope ?? 0, turns_freely: slope === null,
    })),
    tip: {
      x: x[x.length - 1], y: y[y.length - 1], z: z && z[z.length - 1], rotation: shape.slope[last],
      lateral_mm: y[y.length - 1], held: tip !== null, input_y: shape.u[last],
    },
    bevel: {
      side: Math.abs(roll) > 90 ? -1 : 1, roll_deg: roll,
      ...(model.pathAngle ? { cut_angle_deg: bevel.strength * (180 / Math.PI) } : { offset_mm: bevel.strength }),
    },
    layers: model.mu.map((mu, layer) => ({
      mu_pa: mu * 1e6,
      ...Object.fromEntries(scene.shape_parameters.map(({ name }, row) => [name, model.shape[row][layer]])),
    })),
    max_slope: validity.max_slope,
    faults: listFaults(validity, rules.validity),
    errors: scene.measured && computeErrors(session, scene.measured),
  };
}

/** Constraint points, and where the tip was at their depths. @param {Session} session */
function placePoints(session) {
  const { planes, constraints, track } = session.shape;
  const cut = columns(constraints, 1 + planes);
  const [x, ...needle] = columns(session.positions(cut[0]), 1 + planes);
  const gaps = columns(listGaps(session.shape).flat(), planes);
  const tip = columns(track, 2 * planes);
  const points = needle.map((row, p) => row.map((place, i) => place - gaps[p][i]));
  const path = points.map((row, p) => row.map((place, i) => place + tip[2 * p][i] - cut[1 + p][i]));
  /** @param {number[][]} rows @returns {Curve} */
  const curve = ([y, z]) => ({ x, y, z });
  return { constraints: curve(points), tip_path: curve(path) };
}

/** The lateral load of the tissue, N/mm, along y or in space its magnitude: its mean over two spacings, and where it acts. @param {SteeredNeedle} steered */
export function describeLoad({ session, model }) {
  const { depth, planes } = session.shape;
  const count = Math.ceil((SAMPLES * depth) / model.spacing);
  const s = Array.from({ length: count + 1 }, (_, i) => depth * (i / (count || 1)));
  const [x, y] = columns(session.positions(s), 1 + planes);
  const loads = session.load(s);
  const means = Array.from({ length: planes }, (_, p) => loads.subarray(p * s.length, (p + 1) * s.length)).map((row) => {
    const sums = [0];
    for (const value of row) sums.push(sums[sums.length - 1] + value);
    return s.map((_, i) => {
      const half = Math.min(SAMPLES, i, count - i);
      return (sums[i + half + 1] - sums[i - half]) / (2 * half + 1);
    });
  });
  return { x, y, load: planes === 1 ? means[0] : means[0].map((one, i) => Math.hypot(one, means[1][i])) };
}

/** Where the needle is drawn: all nodes, and more of them before the tissue. @param {Shape} shape */
function listStations({ x, depth }) {
  const end = Math.min(0, depth);
  const before = Array.from({ length: POINTS_BEFORE_TISSUE }, (_, i) => x[0] + ((end - x[0]) * i) / (POINTS_BEFORE_TISSUE - 1));
  before[POINTS_BEFORE_TISSUE - 1] = end;
  return Float64Array.from(new Set([...before, ...x])).sort();
}
