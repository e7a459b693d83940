/** What the page shows of a simulated needle: places in mm, rotations in rad, loads in N and mm. */

import { guideNumber, rollOf, wrap } from "./inputs.js";
import { computeErrors } from "./errors.js";
import { listFaults } from "./validity.js";

const POINTS_BEFORE_TISSUE = 25; // of the needle that are drawn

const columns = (points, width) =>
  Array.from({ length: width }, (_, axis) => Array.from({ length: points.length / width }, (_, i) => points[width * i + axis]));

/** How strongly a bevel turns the cut, under the key of the rule of advance. */
const describeStrength = ({ offset, cutAngle }, { pathAngle }) =>
  pathAngle ? { cut_angle_deg: cutAngle * (180 / Math.PI) } : { offset_mm: offset };

/** All that changes from step to step; `z`, and a third row of points, are of a needle in space. */
export function describeState(steered) {
  const { scene, session, step, model, names, validity, rules } = steered;
  const { shape } = session;
  const { controls, bevel } = step;
  const width = 1 + shape.planes;
  const [x, y, z = null] = columns(session.positions(listStations(shape)), width);
  const constraints = columns(shape.constraints, width);
  const track = columns(shape.track, 2 * shape.planes).filter((_, i) => i % 2 === 0);
  const load = session.forces();
  const loaded = columns(load.s.length ? session.positions(load.s) : [], width);
  const last = shape.x.length - 1;
  const roll = wrap(rollOf(bevel));
  const items = controls.guides.map(({ name }) => guideNumber(name, names));
  return {
    kind: "state",
    step: steered.number,
    depth_mm: step.depth,
    x, y, z,
    depths: constraints[0],
    constraints: mapPoints(session, constraints),
    tip_path: mapPoints(session, [constraints[0], ...track]),
    load: { x: loaded[0], y: loaded[1], n_per_mm: load.loads.map((one) => [...one]) },
    forces: {
      base_n: load.base.force,
      base_nmm: load.base.moment,
      guides_n: Object.fromEntries(items.map((item, i) => [item, load.guides[i].force])),
    },
    base: { x: x[0], y: y[0], rotation: shape.slope[0], input_y: controls.baseY, input_slope: controls.baseSlope },
    guides: controls.guides.map(({ name, x, y, slope }, i) => ({
      item: items[i], name, x, y, slope: slope ?? 0, turns_freely: slope === null,
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

/** Points given by beam coordinate and deflections, where the needle is: each moves with the needle's point beside it. */
function mapPoints(session, /** @type {any[]} */ [s, ...beside]) {
  const [along, ...places] = columns(session.positions(s), 1 + beside.length);
  const deflections = session.deflections(s);
  return [along, ...places.map((one, plane) => one.map((place, i) => place + (beside[plane][i] - deflections[plane * s.length + i])))];
}
