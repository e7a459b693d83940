/** The needle of this window: it is simulated here; its steps are recorded by the program. */

import { compile } from "../../mechanics/native/needle.js";
import { findChanges, ModelError } from "./model/inputs.js";
import { describeState } from "./model/state.js";
import { makeLaw, SteeredNeedle } from "./model/steered.js";
import { publish, take } from "./store.js";

const MAX_UNDO = 200; // gestures that can be undone
const LONGEST = 0.1; // s that a motion goes on in one frame: after a pause the needle does not jump
const SAME = 1e-9; // mm; depths that differ by less are one
const SHORTEST = 0.1; // mm; a shorter move is not divided

/** The kernel, compiled once. */
export const kernel = fetch("/mechanics/native/kernel.wasm").then((answer) => answer.arrayBuffer()).then(compile);

class Trial {
  pinned; // steps whose states are kept, for a later step returns to them
  scene = null;
  steered = null;
  outbox = []; // steps that the program has not confirmed: [number, time (s), gesture, changes, y of the tip (mm)]
  recorded = 0; // steps that it has confirmed
  ended = null; // why nothing more is recorded

  /** Begin with a scene of the program and the steps that its needle has made. */
  async begin(scene) {
    const { past, tables } = scene;
    const steered = await SteeredNeedle.begin(await kernel, scene);
    this.motion = this.ended = null; // what goes on by itself: {kind, speed, gesture, frames}
    Object.assign(this, { scene, steered, past: [], future: [], gesture: null, pinned: new Set(), outbox: [] });
    this.began = past.length ? performance.now() - 1000 * scene.time_s : null;
    this.takeTables(tables);
    const returns = findLastReturns(past);
    for (const [number, , gesture, changes] of past) {
      this.perform(changes, gesture, { validOnly: false });
      this.#pinFor(returns, number, changes);
    }
    this.recorded = steered.number;
    publish("moved");
  }

  /** The program has recorded so many steps. */
  confirm(number) {
    this.outbox = this.outbox.filter(([one]) => one > number);
    this.recorded = Math.max(number, this.recorded);
  }

  /** Laws that are tables, which only the program computes: pairs of shape parameters and all layers' laws. */
  takeTables(tables) {
    this.scene.simulation.law.tables.push(...tables);
  }

  /** The shape parameters after changes whose law has to be asked for; null where it is known. */
  findUnknownLaw(changes) {
    const shape = this.steered.shapeAfter(changes);
    if (JSON.stringify(shape) === JSON.stringify(this.steered.shape)) return null;
    return makeLaw(this.scene.simulation.law, shape) ? null : shape;
  }

  /** Time since the first step, s. */
  time() {
    this.began ??= performance.now();
    return (performance.now() - this.began) / 1000;
  }

  /** Carry out and record one step of changes [name, item, value]; a ModelError if the model does not take it. */
  act(given, gesture) {
    if (this.ended) throw new ModelError(this.ended.what, this.ended.expected, this.ended.fix);
    const changes = given.map(([name, item, value]) => [name, item, value + 0]); // JSON has no -0
    const time = this.time();
    this.perform(changes, gesture);
    this.outbox.push([this.steered.number, time, gesture, changes, this.steered.tipLateral]);
    publish("accepted");
    publish("moved");
  }

  /** Carry out a step; steps of the same gesture are undone together. */
  perform(changes, gesture, how = {}) {
    const { steered } = this;
    const { number } = steered;
    const back = gesture === "undo" || gesture === "redo";
    const begins = back || gesture !== this.gesture;
    if (begins) steered.keep();
    try {
      steered.apply(changes, how);
    } catch (error) {
      this.#forget([number]);
      throw error;
    }
    if (!begins) return;
    this.gesture = back ? null : gesture;
    if (back) {
      const [source, target] = gesture === "undo" ? [this.past, this.future] : [this.future, this.past];
      target.push(number);
      return this.#forget([source.pop()]);
    }
    const left = [...this.future, ...this.past.slice(0, 1 - MAX_UNDO)];
    this.past = [...this.past.slice(1 - MAX_UNDO), number];
    this.future = [];
    this.#forget(left);
  }

  #forget(numbers) {
    const kept = [...this.past, ...this.future, ...this.pinned];
    for (const number of numbers) if (!kept.includes(number)) this.steered.forget(number);
  }

  /** Store the state after a step if a later one returns to it; delete a state after its last return. */
  #pinFor(returns, number, changes) {
    if (returns.has(number)) {
      this.pinned.add(number);
      this.steered.keep();
    }
    for (const [name, , value] of changes) {
      if (name !== "return_to" || returns.get(value) !== number) continue;
      this.pinned.delete(value);
      this.#forget([value]);
    }
  }

  /** Undo the last gesture, or redo the one that was undone last. */
  undo(redo = false) {
    const from = redo ? this.future : this.past;
    if (from.length) this.act([["return_to", null, from.at(-1)]], redo ? "redo" : "undo");
  }

  /** Return to first contact with the present parameters of the model, which a band and a planner keep too. */
  reset(gesture) {
    const { step, shape, model, names, scene, saved } = this.steered;
    const first = saved.get(0);
    const { side, roll } = first.step.bevel;
    const bevel = { ...step.bevel, side, roll };
    const values = (one, mu) => mu.map((value, layer) => [value * 1e6, ...one.map((row) => row[layer])]);
    const before = values(first.shape, first.session.model.mu);
    const inputs = ["mu_pa", ...scene.shape_parameters.map(({ name }) => name)];
    const layers = values(shape, model.mu).flatMap((row, layer) =>
      row.every((value, i) => value === before[layer][i]) ? [] : row.map((value, i) => [inputs[i], layer + 1, value]));
    const changes = [...layers, ...findChanges({ ...first.step, bevel }, first.step, names)];
    this.act([["return_to", null, 0]], gesture);
    if (changes.length) this.act(changes, gesture);
  }

  /** Whether the needle goes in or out by itself, alone. */
  get strokes() {
    return this.motion?.kind === "stroke";
  }

  /** Begin what goes on by itself: a generator that receives the time since the frame before, s. */
  start(kind, speed, gesture, frames) {
    this.motion = { kind, speed, gesture, frames: frames(this, speed, gesture) };
    this.motion.frames.next(); // up to the first frame
    this.at = performance.now();
    publish("moved");
  }

  halt() {
    this.motion = null;
    publish("moved");
  }

  /** Move on by the time since the frame before. */
  advance() {
    if (!this.motion) return;
    const t = performance.now();
    const dt = Math.min((t - this.at) / 1000, LONGEST);
    this.at = t;
    try {
      if (this.motion.frames.next(dt).done) this.motion = null;
    } catch (error) {
      this.motion = null;
      throw error;
    }
  }

  /** Publish the state of the needle. */
  show() {
    const { steered, motion, past, future } = this;
    take({
      ...describeState(steered),
      time_s: steered.number ? this.time() : 0,
      undo: past.length > 0,
      redo: future.length > 0,
      moving: this.strokes ? motion.speed : 0,
      playing: motion !== null && !this.strokes,
      planned: motion?.kind === "plan",
    });
  }
}

export const trial = new Trial();

/** Move the tip: in (out, if `speed` is negative) until it is stopped, or reaches the depth `to`, mm. */
export function* stroke(trial, speed, gesture, to = null) {
  for (let left = Infinity; left > SAME;) {
    const dt = yield;
    const { steered } = trial;
    const [now, reach] = [steered.step.depth, steered.reach()];
    const end = Math.min(Math.max(to, 0), reach);
    const [low, high] = to === null ? [0, reach] : [Math.min(now, end), Math.max(now, end)];
    const depth = Math.min(Math.max(now + speed * dt, low), high);
    left = Math.abs((speed > 0 ? high : low) - depth);
    if (Math.abs(depth - now) > SAME) moveTip(trial, depth, gesture);
  }
}

/** Move the tip to a depth, mm. A move that is refused is divided: the needle comes as near as the model takes it. */
function moveTip(trial, depth, gesture) {
  const { depth: from } = trial.steered.step;
  try {
    trial.act([["depth_mm", null, depth]], gesture);
  } catch (error) {
    if (!error.expected || Math.abs(depth - from) < SHORTEST) throw error;
    moveTip(trial, (from + depth) / 2, gesture);
    moveTip(trial, depth, gesture);
  }
}

/** Move through steps at constant speed. */
export const play = (steps) =>
  function* go(trial, speed, gesture) {
    for (const step of steps) {
      yield;
      const { steered } = trial;
      const changes = findChanges(step, steered.step, steered.names);
      if (changes.length) trial.act(changes, gesture);
      yield* stroke(trial, step.depth >= steered.step.depth ? speed : -speed, gesture, step.depth);
    }
    yield;
  };

/** The steps to which a needle returns, each with the number of the last that does. */
function findLastReturns(steps) {
  const returns = new Map();
  for (const [number, , , changes] of steps) {
    for (const [name, , value] of changes) if (name === "return_to") returns.set(value, number);
  }
  return returns;
}
