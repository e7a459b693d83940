/** The numbers below the picture, limits of the model that are exceeded, and the picture in words. */

import { define, DEFINITIONS } from "./definitions.js";
import { element, entry, part, write } from "./dom.js";
import { describeRoll, isSteered, listErrors, predictionOf, signed, strengthOf, toDegrees, writeError } from "./quantities.js";
import { listen, now } from "./store.js";
import { toPy, view } from "./view.js";

/** What is read of the needle: a name, a unit, and how it is written from a state. @type {[string, string, (state: State) => string][]} */
const NEEDLE = [
  ["depth", "mm", (s) => s.depth_mm.toFixed(2)],
  ["tip y", "mm", (s) => signed(s.tip.lateral_mm, 2)],
  ["tip z", "mm", (s) => (s.tip.z === null ? "–" : signed(s.tip.z, 2))],
  ["tip slope", "°", (s) => signed(toDegrees(s.tip.rotation), 2)],
  ["steepest slope", "", (s) => s.max_slope.toFixed(3)],
];

const TIP_Z = NEEDLE.findIndex(([name]) => name === "tip z");

/** Put readouts into a list; returns what writes them from a state, dashes without one. @template T @param {HTMLElement} list @param {[string, string, (from: T) => string][]} readouts */
function fillReadouts(list, readouts) {
  const numbers = readouts.map(([name, unit]) => {
    const number = element("span", {}, "–");
    list.append(entry(define(name), [number, " ", element("small", {}, unit)]));
    return number;
  });
  return (/** @type {T | null} */ from) => readouts.forEach(([, , read], i) => write(numbers[i], from ? read(from) : "–"));
}

const writeNeedle = fillReadouts(part("readouts"), NEEDLE);
let writeErrors = (/** @type {Errors | null} */ _errors) => {}; // of the comparison with a measured needle: each that is shown

/** Up to where errors compare: whole, or the part of the measured needle that the needle has reached. @param {Errors} errors */
const comparedUpTo = ({ whole, upto_mm: upto }) =>
  whole ? "over the whole insertion" : `over the first ${upto.toFixed(1)} mm`;

listen("scene", ({ measured }) => {
  part("compared").hidden = measured === null;
  if (!measured) return;
  /** @type {[string, string, (errors: Errors) => string][]} */
  const metrics = measured.metrics.map(([name, label, unit]) => [label, unit, (errors) => writeError(errors[name], unit)]);
  for (const [, label, , text] of measured.metrics) DEFINITIONS[label] = text;
  part("errors").replaceChildren();
  writeErrors = fillReadouts(part("errors"), [...metrics, ["noise floor", "mm", ({ floor_mm: floor }) => writeError(floor, "mm")]]);
});

/** Which limits of the model the needle exceeds, in words; empty where it exceeds none. @param {State} state */
const exceeded = ({ faults }) => (faults.length ? `outside the model: ${faults.join("; ")}` : "");

listen("state", (state) => {
  const { scene } = now;
  writeNeedle(state);
  part("readouts").children[TIP_Z].hidden = !state.z;
  const follows = scene.plan && !now.replay?.changed;
  const title = part("title"); // a report has none
  if (title) write(title, `${follows ? "plan: " : isSteered(state, scene) ? "steered by hand: " : ""}${scene.title}`);
  write("described", inWords());
  const words = exceeded(state);
  write("beyond", words && `${words[0].toUpperCase()}${words.slice(1)}. Its shape cannot be relied on.`);
  part("beyond").classList.toggle("low", toPy(state.tip.y) < view.box.top + view.box.height / 2); // not on the tip
  if (!scene.measured) return;
  const prediction = predictionOf(state, scene);
  writeErrors(state.errors && { ...state.errors, ...prediction?.errors });
  write("against", `${prediction ? "prediction " : ""}against ${scene.measured.id}${state.errors ? `, ${comparedUpTo(state.errors)}` : ""}`);
});

/** @param {{ rotation: number }} place */
const angle = ({ rotation }) => `${signed(toDegrees(rotation), 1)} degrees`;

/** The needle's state in a few sentences, for who does not see the picture. */
export function inWords() {
  const { state, scene } = now;
  if (!state) return "The needle has not been drawn yet.";
  const { tip, bevel, base, guides, errors } = state;
  const held = guides.length === 1 ? "1 guide" : `${guides.length} guides`;
  const { symbol, value, digits, unit } = strengthOf(bevel);
  const sentences = [
    `The needle is ${state.depth_mm.toFixed(1)} mm deep, of ${scene.length_mm.toFixed(0)} mm.`,
    `Its tip is ${Math.abs(tip.lateral_mm).toFixed(2)} mm to the ${tip.lateral_mm < 0 ? "right" : "left"}${tip.held ? " and held there" : ""}, at ${angle(tip)}${tip.z === null ? "" : `; z ${signed(tip.z, 2)} mm`}.`,
    `The bevel turns the cut toward ${describeRoll(bevel)}, ${symbol} is ${value.toFixed(digits)} ${unit}.`,
    `The base stands at y ${signed(base.y, 2)} mm, at ${angle(base)}; ${held}.`,
  ];
  if (exceeded(state)) sentences.push(`The needle is ${exceeded(state)}.`);
  if (errors) {
    const prediction = predictionOf(state, scene);
    sentences.push(`${prediction ? "The prediction against" : "Against"} the measured needle ${comparedUpTo(errors)}: ${listErrors(prediction?.errors ?? errors, /** @type {Measured} */ (scene.measured)).join(", ")}.`);
  }
  return sentences.join(" ");
}
