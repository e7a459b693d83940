/** What the page shows of a simulated needle: places in mm, rotations in rad, loads in N and mm. */

import { guideNumber } from "./inputs.js";
import { computeErrors } from "./errors.js";
import { listFaults } from "./validity.js";

const POINTS_BEFORE_TISSUE = 25; // of the needle that are drawn

const column = (points, axis) => Array.from({ length: points.length / 2 }, (_, i) => points[2 * i + axis]);

/** How strongly a bevel turns the cut, under the key of the rule of advance. */
export const describeStrength = ({ offset, cutAngle }, { pathAngle }) =>
  pathAngle ? { cut_angle_deg: cutAngle * (180 / Math.PI) } : { offset_mm: offset };

/** All that changes from step to step. */
export function describeState(steered) {
  const { scene, session, step, model, names, validity, rules } = steered;
  const { shape } = session;
  const { controls, bevel } = step;
  const along = listStations(shape);
  const needle = session.positions(along);
  const load = session.forces();
  const loaded = load.s.length ? session.positions(load.s) : [];
  const [rotations, end] = [shape.slope, needle.length];
  const items = controls.guides.map(({ name }) => guideNumber(name, names));
  return {
    kind: "state",
    step: steered.number,
    depth_mm: step.depth,
    x: column(needle, 0),
    y: column(needle, 1),
    depths: column(shape.constraints, 0),
    constraints: mapPoints(session, shape.constraints),
    tip_path: mapPoints(session, shape.constraints.map((one, i) => (i % 2 ? shape.track[i - 1] : one))),
    load: { x: column(loaded, 0), y: column(loaded, 1), n_per_mm: [...load.load] },
    forces: {
      base_n: load.base.force,
      base_nmm: load.base.moment,
      guides_n: Object.fromEntries(items.map((item, i) => [item, load.guides[i].force])),
    },
    base: { x: needle[0], y: needle[1], rotation: rotations[0], input_y: controls.baseY, input_slope: controls.baseSlope },
    guides: controls.guides.map(({ name, x, y, slope }, i) => ({
      item: items[i], name, x, y, slope: slope ?? 0, turns_freely: slope === null,
    })),
    tip: {
      x: needle[end - 2], y: needle[end - 1], rotation: rotations.at(-1),
      lateral_mm: needle[end - 1], held: controls.tip !== null, input_y: shape.u.at(-1),
    },
    bevel: { side: bevel.side, ...describeStrength(bevel, model) },
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

/** Points given by beam coordinate and deflection, in the plane: each moves with the needle's point beside it. */
function mapPoints(session, points) {
  const s = column(points, 0);
  const [places, deflections] = [session.positions(s), session.deflections(s)];
  return [column(places, 0), s.map((_, i) => places[2 * i + 1] + (points[2 * i + 1] - deflections[i]))];
}
