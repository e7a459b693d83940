/** Errors of the simulated needle against the measured one, as `metrics/` computes them. */

const DEPTH_TOLERANCE = 1e-6; // mm; a needle this near to the measured depth has reached it
const LEAST = 1; // mm; shorter overlaps are not compared
const POINTS = 101;

/** @param {number[]} values */
const mean = (values) => values.reduce((sum, one) => sum + one, 0) / values.length;

/** By metric, from the distances of compared points, that of the tip, and its measured deflection, mm. @type {Record<string, (distances: number[], end: number, deflection: number) => number>} */
const METRICS = {
  ipe_mean_mm: mean,
  te_mm: (_, end) => end,
  edp_percent: (_, end, deflection) => (100 * end) / deflection,
};

/** The axes of the coordinates that are compared. */
const AXES = { plane: [0, 1], space: [0, 1, 2] };

/**
 * The errors of a session's needle against `measured` of the scene, or null where they are undefined.
 *
 * Where `whole` they are those of a study; else of the length that both have in common.
 *
 * @param {Session} session @param {Measured} measured @returns {Errors | null}
 */
export function computeErrors(session, measured) {
  const { depth } = session.shape;
  const upto = Math.min(depth, measured.depth_mm);
  if (upto < LEAST) return null;
  const beyond = depth - measured.depth_mm;
  const whole = Math.abs(beyond) <= DEPTH_TOLERANCE;
  let [simulated, other] = /** @type {number[][][]} */ ([[], []]);
  if (whole) [simulated, other] = readTarget(session, measured.target, beyond);
  else if (measured.target.pose !== "free" && measured.x.length > 1) {
    const s = Array.from({ length: POINTS }, (_, i) => (upto * i) / (POINTS - 1));
    other = s.map((one) => [measured.x, measured.y, measured.z ?? []].map((axis) => interpolate(measured.s, axis, one)));
    simulated = ALIGN[measured.target.pose](readPoints(session, s), other);
  } else return null;
  const axes = AXES[measured.compared];
  /** @param {number[]} one @param {number[]} from @param {number[]} along */
  const apart = (one, from, along = axes) => Math.hypot(...along.map((axis) => one[axis] - from[axis]));
  const distances = simulated.map((point, i) => apart(point, other[i])), across = axes.slice(1);
  const tip = measured.tip && [...measured.tip.x, ...measured.tip.y, ...measured.tip.z]; // measured by itself, at its depth
  let [end, deflection] = [distances[distances.length - 1], apart(other[other.length - 1], other[0], across)];
  if (tip) [end, deflection] = whole ? [apart(readPoints(session, [depth])[0], tip, across), apart(tip, [0, 0, 0], across)] : [NaN, NaN];
  const values = Object.entries(METRICS).map(([name, compute]) => [name, compute(distances, end, deflection)]);
  const finite = values.map(([name, value]) => [name, Number.isFinite(value) ? value : null]);
  return { ...Object.fromEntries(finite), upto_mm: upto, whole, floor_mm: measured.floor_mm };
}

const TIP_POINTS = 2; // that stand for a measured tip: its entry, where nothing deflects, and the tip, at its depth

/** The simulated points as a study compares them, and the measured ones; `beyond`: by how much it is deeper, mm. @param {Session} session @param {Measured["target"]} target */
export function readTarget(session, { s, x, y, z, pose }, beyond = 0) {
  const measured = x.map((one, i) => [one, y[i], z[i]]);
  const points = readPoints(session, s.map((one) => one + beyond));
  const compared = s.length > TIP_POINTS ? points : [measured[0], [x[1], ...points[1].slice(1)]];
  return [ALIGN[pose](compared, measured), measured];
}

/** Points [x, y, z], z 0 of a needle in its plane, at beam coordinates; the last may lie beyond the tip by rounding. @param {Session} session @param {number[]} s */
export function readPoints(session, s) {
  const { x, depth, planes } = session.shape;
  const points = session.positions(s.map((one) => Math.min(Math.max(one, x[0]), depth)));
  return s.map((_, i) => [points[(1 + planes) * i], points[(1 + planes) * i + 1], planes === 1 ? 0 : points[3 * i + 2]]);
}

/** The value at x between points that straight lines join; beyond them that of an end. @param {number[]} xs @param {number[]} values @param {number} x */
export function interpolate(xs, values, x) {
  const after = xs.findIndex((one, i) => i && (one >= x || i === xs.length - 1));
  const share = (x - xs[after - 1]) / (xs[after] - xs[after - 1]);
  return values[after - 1] + Math.min(Math.max(share, 0), 1) * (values[after] - values[after - 1]);
}

/** By what is known of the pose, simulated points as they are compared with others, as `align` in Python. @type {Record<Pose, (simulated: number[][], measured: number[][]) => number[][]>} */
const ALIGN = { known: (simulated) => simulated, direction: shiftAcross, free: alignRigid };

/** Points after the shift across that brings them closest to others, as `align_lateral` with one term in Python. @param {number[][]} moving @param {number[][]} fixed */
function shiftAcross(moving, fixed) {
  const [dy, dz] = [1, 2].map((axis) => mean(moving.map((point, i) => fixed[i][axis] - point[axis])));
  return moving.map(([x, y, z]) => [x, y + dy, z + dz]);
}

/** Points after the rotation and shift in the plane that bring them closest to others, as `align_rigid` in Python. @param {number[][]} moving @param {number[][]} fixed */
function alignRigid(moving, fixed) {
  /** @param {number[][]} points */
  const centre = (points) => [0, 1].map((axis) => mean(points.map((one) => one[axis])));
  const [m, f] = [centre(moving), centre(fixed)];
  let [across, along] = [0, 0];
  moving.forEach(([x, y], i) => {
    const [a, b, c, d] = [x - m[0], y - m[1], fixed[i][0] - f[0], fixed[i][1] - f[1]];
    across += a * d - b * c;
    along += a * c + b * d;
  });
  const angle = Math.atan2(across, along);
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return moving.map(([x, y, z]) => [
    c * (x - m[0]) - s * (y - m[1]) + f[0],
    s * (x - m[0]) + c * (y - m[1]) + f[1],
    z,
  ]);
}
