/** The inputs of a needle, as `planning/steered_needle.py` has them: which values they take, and what they change. */

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
const DEGREES = 180 / Math.PI;
const UNITS = [["_mm", " mm"], ["_deg", "°"], ["_pa", " Pa"]];

/** Throw a ModelError for a change that is none; `rules` are those of the scene. @param {Change} change @param {Rules} rules */
export function checkChange([name, item, value], rules) {
  const known = rules.inputs[name];
  if (!known) throw new ModelError(`there is no input ${name}`, `one of ${Object.keys(rules.inputs).join(", ")}`);
  const counted = item !== null && Number.isInteger(item) && item >= 1 && item <= (known.item === "guide" ? rules.max_guide : Infinity);
  if (known.item ? !counted : item !== null) throw new ModelError(`${name} has item ${item}`, `the number of a ${known.item}`);
  const lengths = name.endsWith("_mm"); // of others, the range says more than the largest number
  const most = lengths ? rules.max_mm : rules.max;
  const finite = Math.abs(value) <= most;
  const { least = -Infinity, above = -Infinity, upto = Infinity, below = Infinity, values } = known;
  const allowed = finite && value >= least && value > above && value <= upto && value < below && (!values || values.includes(value));
  if (!allowed) {
    const range = finite || (known.expected && !lengths);
    const expected = range ? String(known.expected) : `a finite number, at most ${most}${lengths ? " mm" : ""}`;
    throw new ModelError(`${nameOf(name)}${item === null ? "" : ` of ${known.item} ${item}`} is ${written(name, value)}`, expected);
  }
}

/** @param {string} name */
const nameOf = (name) => name.replace(/_(mm|deg|pa)$/, "").replaceAll("_", " ");

/** A value in the unit of the page's fields. @param {string} name @param {number} value */
function written(name, value) {
  if (name === "mu_pa") return Math.abs(value) < 1e6 ? `${significant(value * 1e-3)} kPa` : `${significant(value * 1e-6)} MPa`;
  if (name.endsWith("slope")) return `${(Math.atan(value) * DEGREES).toFixed(1)}°`;
  const [, unit] = UNITS.find(([end]) => name.endsWith(end)) ?? ["", ""];
  return `${significant(value)}${unit}`;
}

/** @param {number} value */
const significant = (value) => Number(value.toPrecision(6));

/** The number of a guide, from 1. @param {string} name @param {string[]} names */
export function guideNumber(name, names) {
  const at = names.indexOf(name);
  return at < 0 ? Number(name.replace("guide ", "")) : at + 1;
}

/** The roll of a bevel, degrees: 0 toward +y, 180 of a bevel of side -1. @param {{ side: number, roll: number }} bevel */
export const rollOf = ({ side, roll }) => roll + (side > 0 ? 0 : 180);

/** Side of a bevel with a roll, and roll from there, as `Bevel.turn`. @param {number} roll */
const toSide = (roll) => (Math.abs(roll % 360) === 180 ? { side: -1, roll: roll - 180 } : { side: 1, roll });

/** A roll between -180, which it is not, and 180 degrees. @param {number} roll */
export const wrap = (roll) => 180 - ((((180 - roll) % 360) + 360) % 360);

/** The change that turns over a bevel with a roll. @param {number} roll @returns {Change} */
export const turnOver = (roll) =>
  roll % 180 ? ["bevel_roll_deg", null, wrap(roll + 180)] : ["bevel_side", null, roll % 360 ? 1 : -1];

/** The step after changes, as `apply_changes`: names are those of the scene's guides, `stands` is where the tip is, y and z, mm. @param {Step} step @param {Change[]} changes @param {string[]} names @param {number[]} stands @returns {Step} */
export function applyChanges(step, changes, names, stands) {
  const values = new Map(changes.filter(([, item]) => item === null).map(([name, , value]) => [name, value]));
  /** @template T @param {string} name @param {T} now */
  const of = (name, now) => values.get(name) ?? now;
  const held = step.controls;
  let { tip } = held;
  if (of("tip_held", 1) === 0) tip = null;
  else if (tip || values.has("tip_held") || values.has("tip_y_mm")) {
    const [y, z] = tip ? [tip.y, tip.z ?? 0] : stands;
    tip = { y: of("tip_y_mm", y), slope: of("tip_slope", tip ? tip.slope : null), z };
  }
  const [angle, side] = [of("cut_angle_deg", null), of("bevel_side", null)];
  const roll = side === null ? rollOf(step.bevel) : rollOf({ side, roll: 0 });
  return {
    depth: of("depth_mm", step.depth),
    bevel: {
      ...toSide(of("bevel_roll_deg", roll)),
      offset: of("bevel_offset_mm", step.bevel.offset),
      cutAngle: angle === null ? step.bevel.cutAngle : angle * RADIANS, // stays to the bit
    },
    controls: {
      baseY: of("base_y_mm", held.baseY),
      baseSlope: of("base_slope", held.baseSlope),
      stageSlope: held.stageSlope,
      guides: applyToGuides(held.guides, changes, names),
      tip,
    },
  };
}

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

/** Inputs as the kernel's `Session` takes them; a ModelError where the bevel's strength is that of the other rule. @param {Omit<Step, "depth">} step @param {boolean} pathAngle @returns {Inputs} */
export function toInputs({ bevel, controls }, pathAngle) {
  if ((pathAngle ? bevel.offset : bevel.cutAngle) !== 0) {
    throw new ModelError("the strength of the bevel is that of the other rule of advance", pathAngle ? "a cut angle alone" : "an offset alone");
  }
  const { baseY, baseSlope, stageSlope, guides, tip } = controls;
  return {
    bevel: { side: bevel.side, roll: bevel.roll, strength: pathAngle ? bevel.cutAngle : bevel.offset },
    base: { y: baseY, slope: baseSlope, stageSlope }, guides, tip: tip && { y: tip.y, slope: tip.slope, z: tip.z ?? 0 },
  };
}

/** The step of what the kernel's `Session` was given. @param {Reached} reached @param {boolean} pathAngle @returns {Step} */
export function toStep({ depth, inputs }, pathAngle) {
  const { bevel, base, guides, tip } = inputs;
  const [offset, cutAngle] = pathAngle ? [0, bevel.strength] : [bevel.strength, 0];
  return {
    depth, bevel: { side: bevel.side, roll: bevel.roll, offset, cutAngle },
    controls: { baseY: base.y, baseSlope: base.slope, stageSlope: base.stageSlope, guides, tip },
  };
}
