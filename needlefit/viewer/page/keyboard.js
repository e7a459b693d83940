/** The keys of the picture, while it has the focus, and the list of them. */

import { element, entry, part, press } from "./dom.js";
import { turnOver, wrap } from "./model/bevel.js";
import { change, newGesture, redo, undo } from "./steering.js";
import { now } from "./store.js";
import { pin } from "./toolbar.js";
import { fit, zoom } from "./view.js";

const ROLL = 10; // degrees
let gesture = 0; // what a key that is held down does is undone together

/** @param {Change} input */
const go = (input) => change([input], { gesture });

/** Insert, or retract if negative, by so many mm, as far as the needle goes. @param {number} mm */
function insert(mm) {
  const { session: { depth }, scene } = now.steered;
  const end = Math.max(Math.min(now.steered.reach(), scene.limits.depth_mm), depth);
  go(["depth_mm", null, Math.min(Math.max(depth + mm, 0), end)]);
}

const flip = () => change([turnOver(now.state.bevel.roll_deg)]);
/** @param {number} by */
const roll = (by) => go(["bevel_roll_deg", null, wrap(now.state.bevel.roll_deg + by)]);
/** @param {number} mm */
const moveBase = (mm) => go(["base_y_mm", null, now.state.base.input_y + mm]);

/** Keys as the browser calls them, what is written for them, and what they do. @type {[string[], string, string, (event: KeyboardEvent) => void][]} */
const KEYS = [
  [["ArrowRight"], "→", "insert 1 mm; with Shift 0.1 mm", (e) => insert(e.shiftKey ? 0.1 : 1)],
  [["ArrowLeft"], "←", "retract, likewise", (e) => insert(e.shiftKey ? -0.1 : -1)],
  [["ArrowUp"], "↑", "base up by 0.1 mm; with Shift by 1 mm", (e) => moveBase(e.shiftKey ? 1 : 0.1)],
  [["ArrowDown"], "↓", "base down, likewise", (e) => moveBase(e.shiftKey ? -1 : -0.1)],
  [["f"], "F", "flip the bevel", flip],
  [["r"], "R", `roll the bevel by ${ROLL}°; with Shift back`, (e) => roll(e.shiftKey ? -ROLL : ROLL)],
  [["k"], "K", "pin this needle to compare with, or unpin", pin],
  [["+", "="], "+", "zoom in; a drag shifts, a double click shows the tissue", () => zoom(1.25)],
  [["-"], "−", "zoom out", () => zoom(0.8)],
  [["1"], "1", "show the whole needle", () => fit("whole")],
  [["2"], "2", "show the tissue", () => fit("tissue")],
  [["3"], "3", "follow the tip", () => fit("tip")],
];
/** @type {Record<string, (event: KeyboardEvent) => void>} */
const COMMANDS = { z: (event) => (event.shiftKey ? redo() : undo()), y: () => redo() };

/** @param {KeyboardEvent} event */
function hear(event) {
  if (!now.state || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const command = event.ctrlKey || event.metaKey;
  const act = command ? COMMANDS[key] : KEYS.find(([keys]) => keys.includes(key))?.[3];
  if (!act) return;
  event.preventDefault();
  if (!event.repeat) gesture = newGesture();
  act(event);
}

for (const [written, what] of [...KEYS.map(([, key, effect]) => [key, effect]), ["Ctrl+Z, Y", "undo, redo"]]) {
  part("key-list").append(entry(element("kbd", {}, written), what));
}
part("picture").addEventListener("keydown", hear);
press("undo", undo);
press("redo", redo);
press("flip", flip);
