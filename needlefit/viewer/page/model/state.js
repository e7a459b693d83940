/** What the page shows of a simulated needle: places in mm, rotations in rad. */

import { guideNumber, rollOf, wrap } from "./inputs.js";
import { computeErrors } from "./errors.js";
import { computeValidity, listFaults } from "./validity.js";

const POINTS_BEFORE_TISSUE = 25; // of the needle that are drawn

const columns = (points, width) =>
  Array.from({ length: width }, (_, axis) => Array.from({ length: points.length / width }, (_, i) => points[width * i + axis]));

/** How strongly a bevel turns the cut, under the key of the rule of advance. */
const describeStrength = ({ offset, cutAngle }, { pathAngle }) =>
  pathAngle ? { cut_angle_deg: cutAngle * (180 / Math.PI) } : { offset_mm: offset };

/** All that changes from step to step; `z` is of a needle in space. */
export function describeState(steered) {
  const { scene, session, step, model, names, rules } = steered;
  const { shape } = session;
  const { controls, bevel } = step;
  const validity = computeValidity(shape, model);
  const [x, y, z = null] = columns(session.positions(listStations(shape)), 1 + shape.planes);
  const last = shape.x.length - 1;
  const roll = wrap(rollOf(bevel));
  return {
    kind: "state",
    step: steered.number,
    depth_mm: step.depth,
    x, y, z,
    base: { x: x[0], y: y[0], rotation: shape.slope[0], input_y: controls.baseY, input_slope: controls.baseSlope },
    guides: controls.guides.map(({ name, x, y, slope }) => ({
      item: guideNumber(name, names), name, x, y, slope: slope ?? 0, turns_freely: slope === null,
    })),
    tip: {
      x: x.at(-1), y: y.at(-1), z: z && z.at(-1), rotation: shape.slope[last],
      lateral_mm: y.at(-1), held: controls.tip !== null, input_y: shape.u[last],
    },
    bevel: { side: Math.abs(roll) > 90 ? -1 : 1, roll_deg: roll, ...describeStrength(bevel, model) },
    layers: model.mu.map((mu, layer) => ({
      mu_pa: mu * 1e6,
      ...Object.fromEntries(scene.shape_parameters.map(({ name }, row) => [name, steered.shape[row][layer]])),
    })),
    max_slope: validity.max_slope,
    faults: listFaults(validity, rules.validity),
    errors: scene.measured && computeErrors(session, scene.measured),
  };
}

/** Where the needle is drawn: all nodes, and more of them before the tissue. */
function listStations({ x, depth }) {
  const end = Math.min(0, depth);
  const before = Array.from({ length: POINTS_BEFORE_TISSUE }, (_, i) => x[0] + ((end - x[0]) * i) / (POINTS_BEFORE_TISSUE - 1));
  before[POINTS_BEFORE_TISSUE - 1] = end;
  return Float64Array.from(new Set([...before, ...x])).sort();
}
