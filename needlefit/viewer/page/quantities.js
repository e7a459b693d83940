/** What quantities, guides and the bevel's strength are called, and how numbers are written and read. */

import { rollOf, wrap } from "./model/bevel.js";

/** @param {number | null} value @param {string} unit */
export const writeError = (value, unit) => (value === null ? "–" : unit === "%" ? brief(value, 3) : value.toFixed(3));

/** Errors with their names and units, those of which a measured needle names the metrics. @param {Errors} errors @param {Measured} measured */
export const listErrors = (errors, { metrics }) =>
  metrics.map(([name, label, unit]) => `${label} ${writeError(errors[name], unit)} ${unit}`);

/** With its sign, a true minus, and none at zero. @param {number} value @param {number} digits */
export function signed(value, digits) {
  const size = Math.abs(value).toFixed(digits);
  if (Number(size) === 0) return size;
  return (value < 0 ? "−" : "+") + size;
}

/** A number of so many significant digits, without idle zeros, as a field holds it. @param {number} value */
export const brief = (value, digits = 4) => String(Number(value.toPrecision(digits)));

/** @param {number} count @param {string} one */
export const counted = (count, one) => `${count} ${one}${count === 1 ? "" : "s"}`;

/** How moduli (Pa) like one are written, stepped and read: in kPa, from 1 MPa on in MPa. @param {number} one */
export function modulusLike(one) {
  const [unit, pascals] = /** @type {[string, number]} */ (one < 1e6 ? ["kPa", 1e3] : ["MPa", 1e6]);
  /** @param {number} value */
  const write = (value, digits = 4) => brief(value / pascals, digits);
  const step = 10 ** Math.floor(Math.log10(one / pascals) - 1); // of two digits
  return { unit, step, write, read: (/** @type {string} */ text) => Number(text) * pascals };
}

/** A modulus, Pa, with its unit. @param {number} value */
export function modulus(value) {
  const { unit, write } = modulusLike(value);
  return `${write(value, 3)} ${unit}`;
}

/** @type {Scale} */
export const toDegrees = (rotation) => (rotation * 180) / Math.PI;
/** @type {Scale} */
export const degrees = (slope) => (Math.atan(slope) * 180) / Math.PI;
/** @type {Scale} */
export const slope = (angle) => Math.tan((Math.min(Math.max(angle, -90), 90) * Math.PI) / 180);

/** What a guide is called: its scene's name for it, or its number alone. @param {{ item: number, name: string }} guide */
export const shortName = ({ item, name }) => (name && name !== `guide ${item}` ? name : String(item));

const OFFSET = { symbol: "b", unit: "mm", digits: 3, step: 0.005, here: "bevel_offset_mm", throughout: "offset_throughout_mm" };
const ANGLE = { symbol: "θ", unit: "°", digits: 2, step: 0.1, here: "cut_angle_deg", throughout: "cut_angle_throughout_deg" };

/** How the strength is called, written and stepped, its inputs from here on and throughout, and its value. @param {Strength} values */
export const strengthOf = ({ offset_mm: offset, cut_angle_deg: angle }) =>
  (angle === undefined ? { ...OFFSET, value: offset ?? 0 } : { ...ANGLE, value: angle });

/** Where a bevel turns the cut to. @param {ShownBevel} bevel */
export const describeRoll = ({ roll_deg: roll }) => (roll % 180 ? `roll ${brief(roll).replace("-", "−")}°` : roll ? "−y" : "+y");

/** @param {number} one @param {number} other */
const near = (one, other) => Math.abs(one - other) <= 1e-9 * Math.abs(other);

/** Whether parameters are others than those with which the needle was opened. @param {State} state @param {Scene} scene */
export const isChanged = ({ bevel, layers }, { fitted }) => !near(strengthOf(bevel).value, strengthOf(fitted).value)
  || layers.some((layer, i) => Object.entries(fitted.layers[i]).some(([name, one]) => !near(layer[name], one)));

/** The predicted needle, which the verdict judges: drawn for the needle as the run has it; null of another one. @param {State} state @param {Scene} scene */
export const predictionOf = (state, scene) =>
  (Math.abs(state.depth_mm - scene.depth_mm) < 1e-6 && !isSteered(state, scene) ? (scene.measured?.prediction ?? null) : null);

/** Whether parameters or inputs are others than those of the measured needle at this depth. @param {State} state @param {Scene} scene */
export function isSteered(state, scene) {
  const { steps } = scene.simulation;
  const { inputs } = steps.find(({ depth }) => depth >= state.depth_mm - 1e-6) ?? steps[steps.length - 1];
  const { base, guides, tip } = state;
  return isChanged(state, scene) || state.bevel.roll_deg !== wrap(rollOf(inputs.bevel)) || tip.held !== Boolean(inputs.tip)
    || base.input_y !== inputs.base.y || base.input_slope !== inputs.base.slope || guides.length !== inputs.guides.length
    || guides.some(({ x, y }, i) => x !== inputs.guides[i].x || y !== inputs.guides[i].y);
}
