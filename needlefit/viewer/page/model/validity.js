/** How near a needle comes to the limits of the model's assumptions, as `compute_validity` in `mechanics/shape.py`. */

const ENTRY_TOLERANCE = -1e-9; // mm; an element that begins before this depth lies before the entry
const GAUSS = [[0.5 - Math.sqrt(0.15), 5 / 18], [0.5, 4 / 9], [0.5 + Math.sqrt(0.15), 5 / 18]];

/** The length of a vector with parts along y, and z. @param {number[]} parts */
const measure = (parts) => (parts.length > 1 ? Math.sqrt(parts[0] ** 2 + parts[1] ** 2) : Math.abs(parts[0]));

/** The greatest |u'|, range of deflection / length, shortening / thinnest layer, miss (mm), and compression of a shape. @param {Shape} shape @param {Model} model @returns {Record<string, number>} */
export function computeValidity(shape, { boundaries, thickness, spacing }) {
  const { x, u, slope, planes, track } = shape;
  const last = x.length - 1;
  const bent = Array.from({ length: planes }, (_, p) => [u, slope].map((one) => one.subarray(p * x.length, (p + 1) * x.length)));
  const cubics = bent.map(() => [0, 0, 0]); // u' = begin + t (bend + t curl) in an element
  const [rotations, missed] = [bent.map(() => 0), bent.map(() => 0)];
  /** @param {number} t */
  const rotate = (t) => {
    cubics.forEach(([begin, bend, curl], p) => (rotations[p] = begin + t * (bend + t * curl)));
    return measure(rotations);
  };
  let steepest = 0, shortening = 0, miss = 0;
  for (let i = 0; i <= last; i += 1) steepest = Math.max(steepest, measure(bent.map(([, one]) => one[i])));
  for (let i = 0; i < last; i += 1) {
    const step = x[i + 1] - x[i];
    bent.forEach(([v, rotation], p) => {
      const mean = (v[i + 1] - v[i]) / step, begin = rotation[i], end = rotation[i + 1];
      cubics[p] = [begin, 6 * mean - 4 * begin - 2 * end, 3 * (begin + end) - 6 * mean];
    });
    const [[, bend, curl]] = cubics;
    const inside = planes > 1 ? [0.25, 0.5, 0.75] : [Math.abs(curl) > 1e-12 ? (-0.5 * bend) / curl : 0];
    for (const at of inside) if (at > 0 && at < 1) steepest = Math.max(steepest, rotate(at));
    for (const [t, weight] of GAUSS) {
      const angle = rotate(t);
      shortening += step * weight * 2 * Math.sin(angle / 2) ** 2;
      if (x[i] < ENTRY_TOLERANCE && angle) rotations.forEach((one, p) => (missed[p] += step * weight * one * (1 - Math.sin(angle) / angle)));
    }
    miss = Math.max(miss, measure(missed));
  }
  for (let i = 0; i < track.length; i += 2 * planes) steepest = Math.max(steepest, measure(bent.map((_, p) => track[i + 2 * p + 1])));
  const entered = 1 + boundaries.filter((end) => end < x[last]).length;
  const widths = boundaries.slice(0, entered).map((end, i) => end - (i ? boundaries[i - 1] : 0)).filter((width) => width > 0);
  const thinnest = widths.length ? Math.max(Math.min(...widths), spacing) : Infinity;
  return {
    max_slope: steepest,
    deflection_per_length: measure(bent.map(([v]) => Math.max(...v) - Math.min(...v))) / (x[last] - x[0]),
    shortening_per_layer: shortening / thinnest,
    miss_mm: miss,
    compression: Math.max(...listGaps(shape).map(measure)) / Math.min(...thickness.slice(0, entered)),
  };
}

/** How far, along y and z, a needle lies from each of its constraint points, mm. @param {Shape} shape @returns {number[][]} */
export function listGaps({ x, u, slope, planes, constraints }) {
  let i = 0;
  return Array.from({ length: constraints.length / (1 + planes) }, (_, k) => { // their depths increase
    const [at, ...places] = constraints.subarray((1 + planes) * k, (1 + planes) * (k + 1));
    while (i < x.length - 2 && x[i + 1] < at - 1e-9) i += 1;
    const span = x[i + 1] - x[i];
    const t = Math.min(Math.max((at - x[i]) / span, 0), 1);
    return places.map((place, p) => {
      const n = p * x.length + i;
      const bend = 3 * (u[n + 1] - u[n]) - span * (2 * slope[n] + slope[n + 1]);
      const curl = 2 * (u[n] - u[n + 1]) + span * (slope[n] + slope[n + 1]);
      return u[n] + t * (span * slope[n] + t * (bend + t * curl)) - place;
    });
  });
}

/** Descriptions of the quantities that exceed their limits; `limits` are [name, limit, words] of the scene. @param {Record<string, number>} validity @param {Rules["validity"]} limits */
export const listFaults = (validity, limits) =>
  limits.filter(([name, limit]) => !(validity[name] <= limit)).map(([name, limit, words]) => {
    const unit = name.endsWith("_mm") ? " mm" : "";
    return `${words} ${Number(validity[name].toPrecision(3))}${unit} (limit ${limit}${unit})`;
  });
