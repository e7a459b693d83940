/** How near a needle comes to the limits of the model's assumptions, as `compute_validity` in `mechanics/shape.py`. */

const ENTRY_TOLERANCE = -1e-9; // mm; an element that begins before this depth lies before the entry
const GAUSS = [[0.5 - Math.sqrt(0.15), 5 / 18], [0.5, 4 / 9], [0.5 + Math.sqrt(0.15), 5 / 18]];

/** The greatest |u'|, range of deflection / length, shortening / thinnest layer, miss (mm), and compression of a shape. */
export function computeValidity({ x, u, slope, constraints, track }, { boundaries, thickness, spacing }) {
  const last = x.length - 1;
  let steepest = 0, shortening = 0, missed = 0, miss = 0, low = u[0], high = u[0];
  for (let i = 0; i <= last; i += 1) {
    steepest = Math.max(steepest, Math.abs(slope[i]));
    low = Math.min(low, u[i]);
    high = Math.max(high, u[i]);
  }
  for (let i = 0; i < last; i += 1) {
    const step = x[i + 1] - x[i], begin = slope[i], end = slope[i + 1];
    const mean = (u[i + 1] - u[i]) / step;
    const bend = 6 * mean - 4 * begin - 2 * end, curl = 3 * (begin + end) - 6 * mean; // u' = begin + t bend + t^2 curl
    const at = Math.abs(curl) > 1e-12 ? (-0.5 * bend) / curl : 0;
    if (at > 0 && at < 1) steepest = Math.max(steepest, Math.abs(begin + at * (bend + at * curl)));
    for (const [t, weight] of GAUSS) {
      const rotation = begin + t * (bend + t * curl);
      shortening += step * weight * 2 * Math.sin(rotation / 2) ** 2;
      if (x[i] < ENTRY_TOLERANCE) missed += step * weight * (rotation - Math.sin(rotation));
    }
    miss = Math.max(miss, Math.abs(missed));
  }
  for (let i = 1; i < track.length; i += 2) steepest = Math.max(steepest, Math.abs(track[i]));
  const entered = 1 + boundaries.filter((end) => end < x[last]).length;
  const widths = boundaries.slice(0, entered).map((end, i) => end - (i ? boundaries[i - 1] : 0)).filter((width) => width > 0);
  const thinnest = widths.length ? Math.max(Math.min(...widths), spacing) : Infinity;
  return {
    max_slope: steepest,
    deflection_per_length: (high - low) / (x[last] - x[0]),
    shortening_per_layer: shortening / thinnest,
    miss_mm: miss,
    compression: compress(x, u, slope, constraints) / Math.min(...thickness.slice(0, entered)),
  };
}

/** The greatest distance of a needle from a constraint point, mm. */
function compress(x, u, slope, constraints) {
  let [greatest, i] = [0, 0];
  for (let k = 0; k < constraints.length; k += 2) { // their depths increase
    const [at, y] = [constraints[k], constraints[k + 1]];
    while (i < x.length - 2 && x[i + 1] < at - 1e-9) i += 1;
    const span = x[i + 1] - x[i];
    const t = Math.min(Math.max((at - x[i]) / span, 0), 1);
    const bend = 3 * (u[i + 1] - u[i]) - span * (2 * slope[i] + slope[i + 1]);
    const curl = 2 * (u[i] - u[i + 1]) + span * (slope[i] + slope[i + 1]);
    greatest = Math.max(greatest, Math.abs(u[i] + t * (span * slope[i] + t * (bend + t * curl)) - y));
  }
  return greatest;
}

/** Descriptions of the quantities that exceed their limits; `limits` are [name, limit, words] of the scene. */
export const listFaults = (validity, limits) =>
  limits.filter(([name, limit]) => !(validity[name] <= limit)).map(([name, limit, words]) => {
    const unit = name.endsWith("_mm") ? " mm" : "";
    return `${words} ${Number(validity[name].toPrecision(3))}${unit} (limit ${limit}${unit})`;
  });
