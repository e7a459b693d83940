/** The needle in the address of a file, such as `#depth=50&b=0.12&roll=180&mu2=300`: a figure in a paper can point to it. */

import { ModelError } from "../model/inputs.js";
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
  const sides = [...cut.map(({ bevel }) => bevel.side), state.bevel.side];
  const turns = cut.filter((_, i) => sides[i] !== sides[i + 1]).map(({ depth }) => exact(depth));
  const values = new URLSearchParams(name === null ? {} : { needle: name });
  values.set("depth", exact(state.depth_mm));
  values.set("roll", state.bevel.side > 0 ? "0" : "180");
  if (turns.length) values.set("turn", turns.join(","));
  const { value, key: strength } = strengthOf(state.bevel);
  for (const [key, input, item, factor] of listKeys(scene)) {
    const now = item ? state.layers[item - 1][input] / factor : key === "base_y" ? state.base.input_y
      : key === "base_slope" ? degrees(state.base.input_slope) : value;
    const begun = item ? scene.fitted.layers[item - 1][input] / factor : key.startsWith("base") ? 0 : scene.fitted[strength];
    if (exact(now) !== exact(begun) || key === "b" || key === "theta") values.set(key, exact(now));
  }
  return values.toString().replaceAll("%2C", ",");
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
  const roll = values.get("roll") ?? (first.bevel.side > 0 ? "0" : "180");
  if (!["0", "180"].includes(roll)) throw new ModelError(`the address has roll=${roll}`, "0 (bevel toward +y) or 180: the needle stays in its plane");
  const turns = (values.get("turn") ?? "").split(",").filter(Boolean).map((text) => number("turn", text));
  let side = (roll === "0" ? 1 : -1) * (-1) ** turns.length;
  const inputs = keys.filter(([key]) => values.has(key)).map(([key, input, item, factor]) => {
    const value = number(key, values.get(key));
    return [input, item, factor === null ? slope(value) : value * factor];
  });
  const lists = [ANEW, [["bevel_side", null, side], ...inputs]];
  for (const depth of turns) lists.push([["depth_mm", null, depth]], [["bevel_side", null, (side = -side)]]);
  return [...lists, [["depth_mm", null, number("depth", values.get("depth"))]]];
}
