/** The needle that is steered: what is asked for is carried out at once, and can be undone. */

import { part, write } from "./dom.js";
import { ModelError } from "./model/inputs.js";
import { describeState } from "./model/state.js";
import { insert } from "./stored.js";
import { now, publish, take } from "./store.js";

const refusal = part("refusal");
/** @type {number[][]} */
const [past, future] = [[], []]; // numbers of states that are kept to return to
let [steps, gestures, last] = [0, 0, 0];

/** A number for inputs that are undone together. */
export const newGesture = () => (gestures += 1);

/** State below a part why the model does not take something. @param {unknown} error @param {Element} below */
export function refuse(error, below = part("flip").parentElement) {
  if (!(error instanceof ModelError)) throw error;
  below.after(refusal);
  write(refusal, `${error.what}. Expected: ${error.expected}.`);
}

/** Publish the needle as it stands. */
export function show() {
  steps += 1; // of all needles together
  part("undo").disabled = !past.length;
  part("redo").disabled = !future.length;
  take("state", { ...describeState(now.steered), step: steps });
}

/** Forget what was steered: the needle was begun anew, or replayed. */
export function forgetPast() {
  for (const one of [past, future]) one.length = 0;
  last = 0;
  write(refusal, "");
}

/** The needle as the file has it: at the end of its scene. */
export function goHome() {
  forgetPast();
  now.steered.rewind();
  try {
    insert(now.steered);
  } catch (error) {
    refuse(error);
  }
  show();
}

/**
 * Carry out lists of changes, one after the other, as one gesture.
 *
 * What the model does not take is stated `below` a part, and the needle stays there, or if `whole` as it was.
 *
 * @param {Change[][]} lists @param {Gesture} how
 */
export function steer(lists, { gesture = newGesture(), whole = false, below } = {}) {
  const { steered } = now;
  const { number } = steered;
  publish("steers");
  write(refusal, "");
  const begins = gesture !== last;
  if (begins || whole) steered.keep();
  try {
    for (const changes of lists) steered.apply(changes.map(([name, item, value]) => [name, item, value + 0])); // a file has no -0
  } catch (error) {
    refuse(error, below);
    if (whole && steered.number > number) steered.apply([["return_to", null, number]]);
    if (whole || steered.number === number) return void publish("unchanged");
  }
  if (begins) {
    past.push(number);
    future.length = 0;
  }
  last = gesture;
  part("back").disabled = false;
  show();
}

/** @param {Change[]} changes @param {Gesture} [how] */
export const change = (changes, how) => steer([changes], how);

/** @param {number[]} from @param {number[]} to */
function goTo(from, to) {
  const number = from.pop();
  if (number === undefined) return;
  publish("steers");
  write(refusal, "");
  const { steered } = now;
  steered.keep();
  to.push(steered.number);
  steered.apply([["return_to", null, number]]);
  last = 0;
  show();
}

export const undo = () => goTo(past, future);
export const redo = () => goTo(future, past);
