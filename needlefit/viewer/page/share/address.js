/**
 * The needle in the address of a file, such as `#depth=50&b=0.12&roll=120&turn=20:90,35&mu2=300`: a figure in a paper can
 * point to it. `roll` is that of the bevel at the end, degrees; at 20 mm it was turned by 90 degrees, at 35 mm over.
 */

import { ModelError, rollOf, wrap } from "../model/inputs.js";
import { brief, degrees, slope, strengthOf } from "../quantities.js";

const ANEW = [["return_to", null, 0]];
const SAME = 1e-9; // mm
const exact = (value) => brief(value, 8);

/** What can stand in the address besides depth, turns and roll: [key, input, item, factor of the value]. */
function listKeys({ fitted, shape_parameters: shapes }) {
  const { key, throughout } = strengthOf(fitted);
  const layers = fitted.layers.flatMap((_, i) => [[`mu${i + 1}`, "mu_pa", i + 1, 1e3], ...shapes.map(({ name }) => [`${name}${i + 1}`, name, i + 1, 1])]);
  return [[key === "offset_mm" ? "b" : "theta", throughout, null, 1], ...layers, ["base_y", "base_y_mm", null, 1], ["base_slope", "base_slope", null, null]];
}

/** The address of a needle without its `#`. `path` are the shortest steps that lead to it; guides and a held tip are not in it. */
export function writeAddress(state, scene, path, name = null) {
  const cut = path.filter(({ depth }, i) => depth > (path[i - 1]?.depth ?? 0) + SAME);
  const rolls = [...cut.map(({ bevel }) => rollOf(bevel)), state.bevel.roll_deg];
  const turns = cut.map(({ depth }, i) => [depth, wrap(rolls[i + 1] - rolls[i])]).filter(([, by]) => by !== 0);
  const values = new URLSearchParams(name === null ? {} : { needle: name });
  values.set("depth", exact(state.depth_mm));
  values.set("roll", exact(state.bevel.roll_deg));
  if (turns.length) values.set("turn", turns.map(([depth, by]) => `${exact(depth)}${by === 180 ? "" : `:${exact(by)}`}`).join(","));
  const { value, key: strength } = strengthOf(state.bevel);
  for (const [key, input, item, factor] of listKeys(scene)) {
    const now = item ? state.layers[item - 1][input] / factor : key === "base_y" ? state.base.input_y
      : key === "base_slope" ? degrees(state.base.input_slope) : value;
    const begun = item ? scene.fitted.layers[item - 1][input] / factor : key.startsWith("base") ? 0 : scene.fitted[strength];
    if (exact(now) !== exact(begun) || key === "b" || key === "theta") values.set(key, exact(now));
  }
  return values.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
}

/** The name of the needle that an address has; null without one. */
export const nameIn = (address) => new URLSearchParams(address).get("needle");

/** Lists of changes that lead to the needle of an address from first contact on; null where it has no depth, a ModelError where it is wrong. */
export function readAddress(address, scene) {
  const values = new URLSearchParams(address);
  if (!values.has("depth")) return null;
  const keys = listKeys(scene);
  const number = (key, text) => {
    if (text.trim() !== "" && Number.isFinite(Number(text))) return Number(text);
    throw new ModelError(`the address has ${key}=${text}`, "a number");
  };
  const known = ["needle", "depth", "roll", "turn", ...keys.map(([key]) => key)];
  for (const key of values.keys()) if (!known.includes(key)) throw new ModelError(`the address has ${key}`, known.join(", "));
  const [first] = scene.simulation.steps;
  const end = values.has("roll") ? number("roll", values.get("roll")) : rollOf(first.bevel);
  const turns = (values.get("turn") ?? "").split(",").filter(Boolean).map((text) => {
    const [depth, by = "180"] = text.split(":");
    return [depth, by].map((one) => number("turn", one));
  });
  let roll = wrap(end - turns.reduce((sum, [, by]) => sum + by, 0));
  const inputs = keys.filter(([key]) => values.has(key)).map(([key, input, item, factor]) => {
    const value = number(key, values.get(key));
    return [input, item, factor === null ? slope(value) : value * factor];
  });
  const lists = [ANEW, [["bevel_roll_deg", null, roll], ...inputs]];
  for (const [depth, by] of turns) lists.push([["depth_mm", null, depth]], [["bevel_roll_deg", null, (roll = wrap(roll + by))]]);
  return [...lists, [["depth_mm", null, number("depth", values.get("depth"))]]];
}
