/**
 * The needle in the address of a file, such as `#depth=50&b=0.12&roll=120&turn=20:90,35&mu2=300`: at 20 mm
 * the bevel was turned by 90 degrees, at 35 mm over, to a roll of 120 degrees at the end.
 */

import { readPoints } from "./model/errors.js";
import { rollOf, wrap } from "./model/bevel.js";
import { ModelError } from "./model/inputs.js";
import { SteeredNeedle } from "./model/steered.js";
import { strengthOf } from "./quantities.js";

const POINTS = 21; // of two needles that are compared
export const SAME = 1e-6; // mm: what differs by more is another needle
const DIGITS = 12; // of a number of an address

/** What can stand in the address besides depth, turns and roll. @param {Scene} scene @returns {AddressKey[]} */
function listKeys({ fitted, shape_parameters: shapes }) {
  const { throughout, symbol } = strengthOf(fitted);
  const [name, toModel] = symbol === "b" ? ["b", 1] : ["theta", Math.PI / 180];
  return [[name, throughout, null, 1, toModel, ({ inputs }) => inputs.bevel.strength], ...fitted.layers.flatMap((_, i) => [
    /** @type {AddressKey} */ ([`mu${i + 1}`, "mu_pa", i + 1, 1e3, 1e-3, ({ model }) => model.mu[i]]),
    ...shapes.map(({ name }, row) => /** @type {AddressKey} */ ([name + (i + 1), name, i + 1, 1, 1, ({ model }) => model.shape[row][i]])),
  ])];
}

/** @param {number} value */
const shorten = (value) => Number(value.toPrecision(DIGITS));

/**
 * Resolves to the address of a needle, without its `#`; null where depth, turns and roll of the bevel, and parameters of the
 * whole insertion do not lead to it.
 *
 * @param {WebAssembly.Module} kernel @param {SteeredNeedle} steered @param {string | null} [name]
 */
export async function writeAddress(kernel, steered, name = null) {
  const { scene, session } = steered;
  const path = session.path();
  const rolls = path.map(({ inputs }) => wrap(rollOf(inputs.bevel)));
  const values = new URLSearchParams(name === null ? {} : { needle: name });
  values.set("depth", String(session.depth));
  values.set("roll", String(rolls.at(-1)));
  const turns = path.slice(0, -1).map(({ depth }, i) => {
    const by = shorten(wrap(rolls[i + 1] - rolls[i]));
    return by === 180 ? depth : `${depth}:${by}`;
  });
  if (turns.length) values.set("turn", turns.join(","));
  const { model, steps: [{ inputs }] } = scene.simulation;
  for (const [key, , item, , toModel, read] of listKeys(scene)) {
    const value = read(session);
    if (!item || value !== read({ model, inputs })) values.set(key, String(shorten(value / toModel)));
  }
  const address = values.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
  return (await leadsTo(kernel, address, steered)) ? address : null;
}

/** Whether an address leads to a needle. @param {WebAssembly.Module} kernel @param {string} address @param {SteeredNeedle} steered */
async function leadsTo(kernel, address, steered) {
  const other = await SteeredNeedle.begin(kernel, steered.scene);
  try {
    for (const changes of readAddress(address, steered.scene)) other.apply(changes);
  } catch (error) {
    if (!(error instanceof ModelError)) throw error;
    return false;
  }
  const s = Array.from({ length: POINTS }, (_, i) => (steered.session.depth * i) / (POINTS - 1));
  const [reached, wanted] = [other, steered].map(({ session }) => readPoints(session, s));
  return reached.every((point, i) => Math.hypot(...point.map((value, axis) => value - wanted[i][axis])) < SAME);
}

/** The name of the needle that an address has; null without one. @param {string} address */
export const nameIn = (address) => new URLSearchParams(address).get("needle");

/** The changes that lead to the needle of an address, none where it only names one; a ModelError where it is wrong. @param {string} address @param {Scene} scene @returns {Change[][]} */
export function readAddress(address, scene) {
  const values = new URLSearchParams(address);
  const keys = listKeys(scene);
  const known = ["needle", "depth", "roll", "turn", ...keys.map(([key]) => key)];
  /** @param {string} key @param {string | null} text */
  const number = (key, text, low = -Infinity) => {
    const value = Number(text);
    if (text?.trim() && Number.isFinite(value) && value >= low) return value;
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
  let roll = values.has("roll") ? number("roll", values.get("roll")) : rollOf(first.inputs.bevel);
  const after = turns.toReversed().map(({ by }) => {
    const end = roll;
    roll = wrap(roll - by);
    return end;
  }).reverse();
  /** @type {Change[]} */
  const inputs = keys.filter(([key]) => values.has(key)).map(([key, input, item, toInput]) => [input, item, toInput * number(key, values.get(key))]);
  /** @type {Change[][]} */
  const lists = [[["return_to", null, 0]], [["bevel_roll_deg", null, roll], ...inputs]];
  turns.forEach(({ at }, i) => lists.push([["depth_mm", null, at]], [["bevel_roll_deg", null, after[i]]]));
  return [...lists, [["depth_mm", null, depth]]];
}

/** A recording of a needle as `needlefit view` writes it: its `head`, and a row for each input that led there. @param {string} head @param {SteeredNeedle} steered */
export function writeRecording(head, steered) {
  const rows = steered.listWay().flatMap(({ changes, tip }, i) => changes.map(([name, item, value], n) =>
    `${i + 1},${(i / 10).toFixed(4)},${name},${item ?? ""},${value},${n === changes.length - 1 ? tip : ""}`));
  return `${head}${rows.join("\n")}\n`;
}
