/** What buttons and keys ask for in the same words. */

import { turnOver, wrap } from "./model/inputs.js";
import { heightAt } from "./quantities.js";
import { change, newGesture } from "./steering.js";
import { now } from "./store.js";

const WITHIN = 1000; // ms; a key pressed again so soon goes on with what the one before began
const CLEAR = 2; // mm that a new guide keeps from its neighbours
const BASE_CLEAR = 5; // mm from the base, which stops so far before a guide
const REACH = 0.6; // of the needle's length: a new guide stands nearer than that, to let the needle go in

let lastMove = { what: "", at: -Infinity, gesture: 0 };

function going(what) {
  const at = performance.now();
  const gesture = what === lastMove.what && at - lastMove.at < WITHIN ? lastMove.gesture : newGesture();
  lastMove = { what, at, gesture };
  return { gesture };
}

/** Insert, or retract if negative, by so many mm, as far as the needle goes. */
export function insert(mm) {
  const { step: { depth }, scene } = now.steered;
  const end = Math.max(Math.min(now.steered.reach(), scene.limits.depth_mm), depth);
  change([["depth_mm", null, Math.min(Math.max(depth + mm, 0), end)]], going("insert"));
}

export const goTo = (depth) => change([["depth_mm", null, depth]]);
export const flip = () => change([turnOver(now.state.bevel.roll_deg)]);

/** Roll the bevel on by an angle, degrees. */
export const roll = (by) => change([["bevel_roll_deg", null, wrap(now.state.bevel.roll_deg + by)]], going("roll"));

export const moveBase = (mm) => change([["base_y_mm", null, now.state.base.input_y + mm]], going("base"));

/** Put a guide on the needle between base and skin, where it changes next to nothing yet. */
export function addGuide() {
  const [item, x] = [freeNumber(), freePlace()];
  change([["guide_x_mm", item, x], ["guide_y_mm", item, heightAt(now.state, x)], ["guide_turns_freely", item, 1]]);
}

/** Hold the tip where it is, or let go of it. */
export const toggleTip = () => change([["tip_held", null, now.state.tip.held ? 0 : 1]]);

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
