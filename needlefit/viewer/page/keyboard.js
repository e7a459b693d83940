/** The keys of the picture, while it has the focus, and the list of them. */

import * as act from "./actions.js";
import { element, entry, part, press } from "./dom.js";
import { ROLL } from "./quantities.js";
import { describe } from "./readouts.js";
import { redo, undo } from "./steering.js";
import { now } from "./store.js";
import { pin } from "./strip.js";
import { fit, zoom } from "./view.js";

/** Keys as the browser calls them, what is written for them, and what they do. @type {[string[], string, string, (event: any) => void][]} */
const KEYS = [
  [["ArrowRight"], "→", "insert 1 mm; with Shift 0.1 mm", (e) => act.insert(e.shiftKey ? 0.1 : 1)],
  [["ArrowLeft"], "←", "retract, likewise", (e) => act.insert(e.shiftKey ? -0.1 : -1)],
  [["ArrowUp"], "↑", "base up by 0.1 mm; with Shift by 1 mm", (e) => act.moveBase(e.shiftKey ? 1 : 0.1)],
  [["ArrowDown"], "↓", "base down, likewise", (e) => act.moveBase(e.shiftKey ? -1 : -0.1)],
  [["f"], "F", "flip the bevel", () => act.flip()],
  [["r"], "R", `roll the bevel by ${ROLL}°; with Shift back`, (e) => act.roll(e.shiftKey ? -ROLL : ROLL)],
  [["g"], "G", "add a guide", () => act.addGuide()],
  [["t"], "T", "hold the tip, let go of it", () => act.toggleTip()],
  [["k"], "K", "pin this needle to compare with, or unpin", () => pin()],
  [["d"], "D", "say where the needle stands", () => describe()],
  [["+", "="], "+", "zoom in", () => zoom(1.25)],
  [["-", "_"], "−", "zoom out", () => zoom(0.8)],
  [["0", "1"], "0, 1", "show the whole needle", () => fit("whole")],
  [["2"], "2", "show the tissue", () => fit("tissue")],
  [["3"], "3", "follow the tip", () => fit("tip")],
];
const COMMANDS = { z: (event) => (event.shiftKey ? redo() : undo()), y: () => redo() };

function hear(event) {
  if (!now.state || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const command = event.ctrlKey || event.metaKey;
  const act = command ? COMMANDS[key] : KEYS.find(([keys]) => keys.includes(key))?.[3];
  if (!act) return;
  event.preventDefault();
  act(event);
}

for (const [written, what] of [...KEYS.map(([, key, effect]) => [key, effect]), ["Ctrl+Z, Y", "undo, redo"]]) {
  part("key-list").append(entry(element("kbd", {}, written), what));
}
part("canvas").addEventListener("keydown", hear);
press("undo", undo);
press("redo", redo);
press("flip", act.flip);
