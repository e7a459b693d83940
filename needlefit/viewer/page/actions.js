/** What buttons, keys and gestures ask for in the same words. */

import { part } from "./dom.js";
import { amount } from "./fields.js";
import { turnOver, wrap } from "./model/inputs.js";
import { heightAt } from "./quantities.js";
import * as steering from "./steering.js";
import { change, move, newGesture, wanted } from "./steering.js";
import { now } from "./store.js";

const WITHIN = 1000; // ms; a key pressed again so soon goes on with what the one before began
const STEP_MM = 0.1; // of the base
const CLEAR = 2; // mm that a new guide keeps from its neighbours
const BASE_CLEAR = 5; // mm from the base, which stops so far before a guide
const REACH = 0.6; // of the needle's length: a new guide stands nearer than that, to let the needle go in

let lastNudge = { what: null, at: -Infinity, gesture: 0 };

/** Speed of insertion, mm/s. */
export const speed = amount(part("speed"));

/** Insert (1) or retract (-1) as long as it is held. */
export const hold = (direction) => move(direction * speed());

/** Insert, or retract if negative, by so many mm. */
export const insert = (mm, at) => change([], { insert: mm, gesture: going("insert"), at });

/** Go to a depth, mm, at the speed. */
export function goTo(depth) {
  const way = depth - now.state.depth_mm;
  if (way) move(Math.sign(way) * speed(), depth);
}

/** The roll of the bevel, degrees, that was asked for last, or is. */
function wantedRoll() {
  const side = wanted("bevel_side", null, 0);
  return wanted("bevel_roll_deg", null, side ? 90 - 90 * side : now.state.bevel.roll_deg);
}

export const flip = (at) => change([turnOver(wantedRoll())], { at });

/** Roll the bevel on by an angle, degrees. */
export const roll = (by, at) => change([["bevel_roll_deg", null, wrap(wantedRoll() + by)]], { gesture: going("roll"), at });

export function nudgeBase(steps, at) {
  const y = wanted("base_y_mm", null, now.state.base.input_y) + steps * STEP_MM;
  change([["base_y_mm", null, y]], { gesture: going("base"), at });
}

/** Put a guide on the needle between base and skin, where it changes next to nothing yet. */
export function addGuide() {
  const [item, x] = [freeNumber(), freePlace()];
  const place = [["guide_x_mm", item, x], ["guide_y_mm", item, heightAt(now.state, x)]];
  change([...place, ["guide_turns_freely", item, 1]]);
}

/** Hold the tip where it is, or let go of it. */
export const toggleTip = (at) => change([["tip_held", null, now.state.tip.held ? 0 : 1]], { at });

export const { undo, redo, reset } = steering;
export const play = () => steering.playScene(speed());

/** The first number that no guide has; the scene's own guides keep theirs. */
function freeNumber() {
  const taken = now.state.guides.map(({ item }) => item);
  let item = now.scene.guide_names.length + 1;
  while (taken.includes(item)) item += 1;
  return item;
}

/** A place before the skin, halfway in the widest gap that guides leave. */
function freePlace() {
  const taken = now.state.guides.map(({ x }) => x).filter((x) => x < 0);
  const first = Math.max(now.state.base.x + BASE_CLEAR, CLEAR - REACH * now.scene.length_mm);
  const edges = [first, ...taken, -CLEAR].sort((one, other) => one - other);
  const gaps = edges.slice(1).map((edge, i) => [edge - edges[i], (edge + edges[i]) / 2]);
  return Math.round(gaps.reduce((widest, gap) => (gap[0] > widest[0] ? gap : widest))[1] * 10) / 10;
}

function going(what) {
  const at = performance.now();
  const gesture = what === lastNudge.what && at - lastNudge.at < WITHIN ? lastNudge.gesture : newGesture();
  lastNudge = { what, at, gesture };
  return gesture;
}
