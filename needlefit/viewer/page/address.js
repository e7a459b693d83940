/**
 * The needle in the address of a file, such as `#depth=50&b=0.12&roll=120&turn=20:90,35&mu2=300`: a figure in a paper can
 * point to it. `roll` is that of the bevel at the end, degrees; at 20 mm it was turned by 90 degrees, at 35 mm over.
 */

import { readPoints } from "./model/errors.js";
import { ModelError, rollOf, wrap } from "./model/inputs.js";
import { SteeredNeedle } from "./model/steered.js";
import { strengthOf } from "./quantities.js";

const ANEW = [["return_to", null, 0]];
const POINTS = 21; // of two needles that are compared
export const SAME = 1e-6; // mm: what differs by more is another needle
const DIGITS = 12; // of a number of an address
const same = (one, other) => JSON.stringify(one) === JSON.stringify(other);

/** What can stand in the address besides depth, turns and roll: {key, input, item, toInput: of its number, unit: in that of the model, read: from a needle}. */
function listKeys({ fitted, shape_parameters: shapes }) {
  const { key, throughout } = strengthOf(fitted);
  const plain = { toInput: (value) => value, unit: 1 };
  const strength = key === "offset_mm"
    ? { ...plain, key: "b", read: ({ step }) => step.bevel.offset }
    : { ...plain, key: "theta", unit: Math.PI / 180, read: ({ step }) => step.bevel.cutAngle };
  const layers = fitted.layers.flatMap((_, i) => [
    { key: `mu${i + 1}`, input: "mu_pa", item: i + 1, toInput: (value) => value * 1e3, unit: 1e-3, read: ({ model }) => model.mu[i] },
    ...shapes.map(({ name }, row) => ({ ...plain, key: `${name}${i + 1}`, input: name, item: i + 1, read: ({ shape }) => shape[row][i] })),
  ]);
  return [{ ...strength, input: throughout, item: null }, ...layers];
}

const shorten = (value) => Number(value.toPrecision(DIGITS));

/** What an address cannot have of the path of a needle, in words. */
function listLost({ scene: { simulation: { steps: [first] } }, step }, path) {
  const all = [...path, step];
  const differs = (read) => all.some((one) => !same(read(one.controls), read(first.controls)));
  return [
    [differs(({ baseY }) => baseY), "the base, which was moved"],
    [differs(({ baseSlope }) => baseSlope), "the base, which was turned"],
    [differs(({ guides }) => guides.map(({ x, y, slope }) => [x, y, slope])), "the guides"],
    [differs(({ tip }) => tip && [tip.y, tip.slope]), "the tip, which was held"],
    [all.some(({ bevel }) => bevel.offset !== step.bevel.offset || bevel.cutAngle !== step.bevel.cutAngle), "b, which changed on the way"],
  ].filter(([is]) => is).map(([, words]) => words);
}

/**
 * Resolves to {address} of a needle, without its `#`, or to {lost}: what it cannot carry, in words.
 *
 * It carries depth, turns and roll of the bevel, and parameters of the whole insertion.
 */
export async function writeAddress(kernel, steered, name = /** @type {string | null} */ (null)) {
  const { scene, step } = steered;
  const path = steered.path();
  const lost = listLost(steered, path);
  if (lost.length) return { lost };
  const rolls = path.map(({ bevel }) => wrap(rollOf(bevel)));
  const values = new URLSearchParams(name === null ? {} : { needle: name });
  values.set("depth", step.depth);
  values.set("roll", rolls.at(-1));
  const turns = path.slice(0, -1).map(({ depth }, i) => {
    const by = shorten(wrap(rolls[i + 1] - rolls[i]));
    return by === 180 ? depth : `${depth}:${by}`;
  });
  if (turns.length) values.set("turn", turns.join(","));
  const { model, shape, steps: [first] } = scene.simulation;
  for (const { key, item, unit, read } of listKeys(scene)) {
    const value = read(steered);
    if (item && value === read({ model, shape, step: first })) continue;
    values.set(key, String(shorten(value / unit)));
  }
  const address = values.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
  return (await leadsTo(kernel, address, steered)) ? { address } : { lost: ["the path"] };
}

/** Whether an address leads to a needle. */
async function leadsTo(kernel, address, steered) {
  const other = await SteeredNeedle.begin(kernel, steered.scene);
  try {
    for (const changes of readAddress(address, steered.scene)) other.apply(changes);
  } catch (error) {
    if (!(error instanceof ModelError)) throw error;
    return false;
  }
  const { depth } = steered.step;
  const points = ({ session }) => readPoints(session, Array.from({ length: POINTS }, (_, i) => (depth * i) / (POINTS - 1)));
  const [found, wanted] = [other, steered].map(points);
  return found.every((point, i) => Math.hypot(...point.map((one, axis) => one - wanted[i][axis])) < SAME);
}

/** The name of the needle that an address has; null without one. */
export const nameIn = (address) => new URLSearchParams(address).get("needle");

/** Lists of changes that lead to the needle of an address from first contact on; none where it only names one. A ModelError where it is wrong. */
export function readAddress(address, scene) {
  const values = new URLSearchParams(address);
  const keys = listKeys(scene);
  const known = ["needle", "depth", "roll", "turn", ...keys.map(({ key }) => key)];
  const number = (key, text, low = -Infinity) => {
    const value = Number(text);
    if (text.trim() !== "" && Number.isFinite(value) && value >= low) return value;
    throw new ModelError(`the address has ${key}=${text}`, low < 0 ? "a number" : `a number, ${low} or above`);
  };
  for (const key of values.keys()) if (!known.includes(key)) throw new ModelError(`the address has ${key}`, known.join(", "));
  const doubled = [...values.keys()].find((key) => values.getAll(key).length > 1);
  if (doubled) throw new ModelError(`the address has ${doubled} more than once`, "each key once");
  if (!values.has("depth")) {
    if ([...values.keys()].some((key) => key !== "needle")) throw new ModelError("the address has no depth", "depth=, in mm");
    return [];
  }
  const [first] = scene.simulation.steps;
  const depth = number("depth", values.get("depth"), 0);
  const turns = (values.get("turn") ?? "").split(",").filter(Boolean).map((text) => {
    const [at, by = "180"] = text.split(":");
    return { at: number("turn", at, 0), by: number("turn", by) };
  });
  const ordered = turns.every(({ at }, i) => at > 0 && at >= (turns[i - 1]?.at ?? 0) && at <= depth); // twice in one place: a new ray
  if (!ordered) throw new ModelError(`the address has turn=${values.get("turn")}`, `increasing depths, up to ${depth} mm`);
  let roll = values.has("roll") ? number("roll", values.get("roll")) : rollOf(first.bevel);
  const after = turns.toReversed().map(({ by }) => {
    const end = roll;
    roll = wrap(roll - by);
    return end;
  }).reverse();
  const inputs = keys.filter(({ key }) => values.has(key)).map(({ key, input, item, toInput }) => [input, item, toInput(number(key, values.get(key)))]);
  const lists = [ANEW, [["bevel_roll_deg", null, roll], ...inputs]];
  turns.forEach(({ at }, i) => lists.push([["depth_mm", null, at]], [["bevel_roll_deg", null, after[i]]]));
  return [...lists, [["depth_mm", null, depth]]];
}

/** A recording of a needle as `needlefit view` writes it: its `head`, and a row for each input that led there. */
export function writeRecording(head, steered) {
  const rows = steered.listWay().flatMap(({ changes, tip }, i) => changes.map(([name, item, value], n) =>
    `${i + 1},${(i / 10).toFixed(4)},${name},${item ?? ""},${value},${n === changes.length - 1 ? tip : ""}`));
  return `${head}${rows.join("\n")}\n`;
}
