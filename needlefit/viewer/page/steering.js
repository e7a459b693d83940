/** Inputs of the hand: the newest one of each counts, and all are carried out at the beginning of the next frame. */

import { post } from "./requests.js";
import { needle, send, sendSteps } from "./connection.js";
import { listen, now, publish } from "./store.js";
import { play, stroke, trial } from "./trial.js";

let waiting = []; // changes that are not carried out yet, one for each gesture
let held = null; // the gesture of a move that a hand holds
let fresh = false; // whether the needle has changed since its state was shown
let oldest = null; // ms, when the oldest input happened that the next state shows
let gestures = Date.now() % 1e9; // a page that was loaded again goes on with numbers of its own
const asked = new Map(); // what was asked for and is not shown yet

/** A number for inputs that are undone together. */
export const newGesture = () => ++gestures;

const key = (name, item) => `${name} ${item ?? ""}`;

/** What an input was last asked to be, or `otherwise` where the state already has it. */
export const wanted = (name, item, otherwise) => asked.get(key(name, item)) ?? otherwise;

/**
 * Ask for a change.
 * @param set triples [name, item, value], all of one step
 * @param how gesture, insert (mm, relative), at (ms, when the hand did it)
 */
export function change(set, { gesture = newGesture(), insert = 0, at = performance.now() } = {}) {
  if (!now.connected) return publish("unsent");
  gesture = held ?? gesture; // what is steered while the needle moves is undone with the move
  for (const [name, item, value] of set) asked.set(key(name, item), value);
  oldest ??= at;
  const last = waiting.at(-1);
  if (last?.gesture !== gesture) waiting.push({ gesture, set: [...set], insert });
  else {
    last.insert += insert;
    const known = new Map([...last.set, ...set].map((one) => [key(one[0], one[1]), one]));
    last.set = [...known.values()];
  }
  publish("moved");
}

/** Do something to the needle; what is refused is published, and ends what goes on by itself. */
function attempt(work) {
  try {
    work();
  } catch (error) {
    if (!error.expected) throw error;
    trial.motion = null;
    asked.clear();
    fresh = true;
    const { what, expected, fix = "" } = error;
    publish("refused", { answers: null, what, expected, fix });
  }
}

/** Carry out what waits. */
function carryOut() {
  const changes = waiting;
  waiting = [];
  changes.forEach((one) => attempt(() => steer(one)));
}

function steer({ gesture, set, insert }) {
  const shape = trial.findUnknownLaw(set);
  if (shape) return void askLaw(shape, { gesture, set, insert });
  const joins = trial.strokes && !insert && !set.some(([name]) => name === "depth_mm");
  if (!joins) takeOver(); // a hand is on the needle
  const { steered } = trial;
  const [depth, reach] = [steered.step.depth, steered.reach()];
  const to = Math.min(Math.max(depth + insert, 0), Math.max(reach, depth));
  trial.act(insert ? [...set, ["depth_mm", null, to]] : set, joins ? trial.motion.gesture : gesture);
}

/** The law is a table, which the program computes. */
async function askLaw(shape, one) {
  try {
    const answer = await post("/law", { needle: needle(), shape });
    trial.takeTables([[shape, await answer.json()]]);
    waiting.unshift(one);
  } catch (fault) {
    publish("refused", { answers: null, ...fault });
  }
  publish("moved");
}

function takeOver() {
  trial.motion = null;
}

/** Send what is no step, after all changes that were asked for before it. */
export function command(message) {
  carryOut();
  return send(message);
}

/** Do something to the needle, after all changes that were asked for before it. */
function direct(work) {
  if (!now.connected) return publish("unsent");
  oldest ??= performance.now();
  carryOut();
  takeOver();
  attempt(work);
  publish("moved");
}

/** Insert (retract, if negative) at a speed, mm/s: on to a depth, or as long as it is held. */
export function move(speed, to = null) {
  const gesture = newGesture();
  held = to === null ? gesture : null;
  direct(() => trial.start("stroke", speed, gesture, (...given) => stroke(...given, to)));
}

export function halt() {
  held = null;
  if (!now.connected) return;
  carryOut();
  trial.halt();
}

/** Let go of a move that a hand holds; one that goes on to a depth goes on. */
export function letGo() {
  if (held !== null) halt();
}

export const undo = () => direct(() => trial.undo());
export const redo = () => direct(() => trial.undo(true));
export const reset = () => direct(() => trial.reset(newGesture()));

/** Carry out lists of changes, one after the other, as one gesture. */
export const rebuild = (lists, gesture = newGesture()) => direct(() => lists.forEach((one) => trial.act(one, gesture)));

/** Play the steps of the scene, from first contact on, at a speed in mm/s. */
export const playScene = (speed) => direct(() => {
  if (trial.steered.number) trial.reset(newGesture());
  trial.start("play", speed, newGesture(), play(trial.scene.simulation.steps));
});

/** Carry out a plan from where the needle stands. */
export function runPlan(plan, speed) {
  const steps = plan.path.filter(({ depth }) => depth > trial.steered.step.depth + 1e-9);
  direct(() => trial.start("plan", speed, newGesture(), play(steps)));
}

/** What a new frame shows: the needle after what was asked for and what goes on by itself; whether it has changed. */
export function advance() {
  if (!trial.scene || !now.connected) return { fresh: false, input: null };
  carryOut();
  if (trial.motion) {
    attempt(() => trial.advance());
    fresh = true;
  }
  const shown = { fresh, input: fresh ? oldest : null };
  if (fresh) {
    [fresh, oldest] = [false, null];
    asked.clear();
    trial.show();
    setTimeout(sendSteps); // once the frame is drawn
  }
  return shown;
}

export const moves = () => trial.motion !== null;

listen("moved", () => (fresh = true));
listen("refused", () => publish("moved")); // fields go back to what is
listen("ended", (fault) => (trial.ended = fault));
listen("line", () => {
  waiting = [];
  [held, oldest] = [null, null];
  asked.clear();
});
addEventListener("blur", letGo);
document.addEventListener("visibilitychange", () => document.hidden && letGo());
