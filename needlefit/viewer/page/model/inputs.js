/** The inputs of a needle, as `planning/steered_needle.py` has them: which values they take, and what they change. */

import { brief, degrees, modulus } from "../quantities.js";
import { rollOf } from "./bevel.js";

/** Why the model does not take something: what, expected. */
export class ModelError extends Error {
  /** @param {string} what @param {string} expected */
  constructor(what, expected) {
    super(what);
    this.what = what;
    this.expected = expected;
  }
}

const RADIANS = Math.PI / 180;
const UNITS = [["_mm", " mm"], ["_deg", "°"], ["_pa", " Pa"]];

/** Throw a ModelError for a change that is none; `rules` are those of the scene. @param {Change} change @param {Rules} rules */
export function checkChange([name, item, value], rules) {
  const known = rules.inputs[name];
  if (!known) throw new ModelError(`there is no input ${name}`, `one of ${Object.keys(rules.inputs).join(", ")}`);
  const counted = item !== null && Number.isInteger(item) && item >= 1 && item <= (known.item === "guide" ? rules.max_guide : Infinity);
  if (known.item ? !counted : item !== null) throw new ModelError(`${name} has item ${item}`, `the number of a ${known.item}`);
  const most = name.endsWith("_mm") ? rules.max_mm : rules.max;
  const { least = -Infinity, above = -Infinity, upto = Infinity, below = Infinity, values } = known;
  const allowed = Math.abs(value) <= most && value >= least && value > above && value <= upto && value < below && (!values || values.includes(value));
  if (!allowed) {
    const which = item === null ? "" : ` of ${known.item} ${item}`;
    throw new ModelError(`${nameOf(name)}${which} is ${written(name, value)}`, (Math.abs(value) <= most && known.expected) || `a number, at most ${written(name, most)}`);
  }
}

/** @param {string} name */
const nameOf = (name) => name.replace(/_(mm|deg|pa)$/, "").replaceAll("_", " ");

/** A value in the unit of the page's fields. @param {string} name @param {number} value */
function written(name, value) {
  if (name === "mu_pa") return modulus(value);
  if (name.endsWith("slope")) return `${degrees(value).toFixed(1)}°`;
  const [, unit] = UNITS.find(([end]) => name.endsWith(end)) ?? ["", ""];
  return brief(value, 6) + unit;
}

/** The number of a guide, from 1. @param {string} name @param {string[]} names */
export function guideNumber(name, names) {
  const at = names.indexOf(name);
  return at < 0 ? Number(name.replace("guide ", "")) : at + 1;
}

/** The step after changes, as `apply_changes`: names are those of the scene's guides, `stands` is where the tip is, y and z, mm. @param {Reached} step @param {Change[]} changes @param {string[]} names @param {number[]} stands @param {Model} model @returns {Reached} */
export function applyChanges({ depth, inputs: { bevel, base, guides, tip } }, changes, names, stands, { pathAngle }) {
  const values = new Map(changes.filter(([, item]) => item === null).map(([name, , value]) => [name, value]));
  /** @template T @param {string} name @param {T} now */
  const of = (name, now) => values.get(name) ?? now;
  const [angle, offset, side] = [of("cut_angle_deg", null), of("bevel_offset_mm", null), of("bevel_side", null)];
  if (pathAngle ? offset : angle) {
    throw new ModelError("the strength of the bevel is that of the other rule of advance", pathAngle ? "a cut angle alone" : "an offset alone");
  }
  const roll = of("bevel_roll_deg", side === null ? rollOf(bevel) : rollOf({ side, roll: 0 }));
  let held = tip;
  if (of("tip_held", 1) === 0) held = null;
  else if (tip || values.has("tip_held") || values.has("tip_y_mm")) {
    const [y, z] = tip ? [tip.y, tip.z ?? 0] : stands;
    held = { y: of("tip_y_mm", y), slope: of("tip_slope", tip && tip.slope), z };
  }
  return {
    depth: of("depth_mm", depth),
    inputs: {
      bevel: { ...toSide(roll), strength: (pathAngle ? angle && angle * RADIANS : offset) ?? bevel.strength }, // what stays, to the bit
      base: { ...base, y: of("base_y_mm", base.y), slope: of("base_slope", base.slope) },
      guides: applyToGuides(guides, changes, names),
      tip: held,
    },
  };
}

/** Side of a bevel with a roll, and roll from there, as `Bevel.turn`. @param {number} roll */
const toSide = (roll) => (Math.abs(roll % 360) === 180 ? { side: -1, roll: roll - 180 } : { side: 1, roll });

/** @param {Guide[]} guides @param {Change[]} changes @param {string[]} names @returns {Guide[]} */
function applyToGuides(guides, changes, names) {
  const moves = /** @type {Map<number, Record<string, number>>} */ (new Map());
  for (const [name, item, value] of changes) {
    if (item === null || !name.startsWith("guide_")) continue;
    moves.set(item, { ...moves.get(item), [name.slice("guide_".length)]: value });
  }
  if (!moves.size) return guides;
  const now = new Map(guides.map((guide) => [guide.name, guide]));
  for (const [item, moved] of [...moves].sort(([one], [other]) => one - other)) {
    const name = names[item - 1] ?? `guide ${item}`;
    if (moved.engaged === 0) {
      now.delete(name);
      continue;
    }
    const guide = { slope: 0, x: moved.x_mm, y: moved.y_mm, ...now.get(name) };
    if (guide.x === undefined || guide.y === undefined) {
      throw new ModelError(`there is no ${name}`, "guide_x_mm and guide_y_mm together, which make a guide");
    }
    /** @type {number | null} */
    let slope = moved.slope ?? guide.slope;
    if (moved.turns_freely !== undefined) slope = moved.turns_freely ? null : (moved.slope ?? guide.slope ?? 0);
    now.set(name, { name, x: moved.x_mm ?? guide.x, y: moved.y_mm ?? guide.y, slope });
  }
  const ordered = [...now.values()].sort((one, other) => one.x - other.x);
  const twice = ordered.find((guide, i) => guide.x === ordered[i + 1]?.x);
  if (twice) throw new ModelError(`two guides stand at the same x = ${twice.x} mm`, "guides at different x");
  return ordered;
}
