/** The keyboard: what each key does, and the list of it. */

import * as act from "./actions.js";
import { aim, place } from "./aim.js";
import { describe } from "./description.js";
import { belongs } from "./focus.js";
import { holds, press, release, releaseAll } from "./held_keys.js";
import { halt } from "./steering.js";
import { now } from "./store.js";
import { pressed } from "./toolbar.js";
import { fit, zoom } from "./view.js";

const dialog = document.getElementById("keys");

/** Keys as the browser calls them, what is written for them, and what they do. */
const KEYS = [
  [["ArrowRight"], "→", "insert, held; with Shift by 0.1 mm", (e) => along(e, 1)],
  [["ArrowLeft"], "←", "retract, held; with Shift by 0.1 mm", (e) => along(e, -1)],
  [["ArrowUp"], "↑", "base up by 0.1 mm; with Shift by 1 mm", (e) => act.nudgeBase(steps(e), e.timeStamp)],
  [["ArrowDown"], "↓", "base down, likewise", (e) => act.nudgeBase(-steps(e), e.timeStamp)],
  [[",", "<", ";"], ",", "turn the base right by 0.1°; with Shift by 1°", (e) => act.nudgeTurn(-steps(e), e.timeStamp)],
  [[".", ">", ":"], ".", "turn it left, likewise", (e) => act.nudgeTurn(steps(e), e.timeStamp)],
  [["f", "F"], "F", "flip the bevel", (e) => e.repeat || act.flip(e.timeStamp)],
  [["[", "{"], "[", "b from here on less by 0.005 mm", (e) => act.nudgeOffset(-1, e.timeStamp)],
  [["]", "}"], "]", "b from here on more by 0.005 mm", (e) => act.nudgeOffset(1, e.timeStamp)],
  [["g", "G"], "G", "add a guide", (e) => e.repeat || act.addGuide()],
  [["t", "T"], "T", "hold the tip, let go of it", (e) => e.repeat || act.toggleTip(e.timeStamp)],
  [[" "], "space", "stop", stop],
  [["p", "P"], "P", "play the scene", (e) => e.repeat || act.play()],
  [["d", "D"], "D", "say where the needle stands", () => describe()],
  [["+", "="], "+", "zoom in", () => zoom(1.25)],
  [["-", "_"], "−", "zoom out", () => zoom(0.8)],
  [["0", "1"], "0, 1", "show the whole needle", () => show("whole")],
  [["2"], "2", "show the tissue", () => show("tissue")],
  [["3"], "3", "follow the tip", () => show("tip")],
];
const steps = (event) => (event.shiftKey ? 10 : 1);
const ALWAYS = [["Esc", "no target, no obstacle after all"], ["Ctrl+Z", "undo"], ["Ctrl+Y", "redo; Ctrl+Shift+Z does the same"], ["?", "this list"]];

function along(event, direction) {
  if (holds(event.key)) return; // it is repeated
  if (event.shiftKey) act.insert(0.1 * direction, event.timeStamp);
  else if (!event.repeat) press(event.key, direction);
}

function stop() {
  releaseAll();
  halt();
}

function show(which) {
  fit(which);
  pressed();
}

function down(event) {
  if (dialog.open || !now.state || event.altKey || belongs(event)) return;
  if (event.ctrlKey || event.metaKey) return history(event);
  if (event.key === "?") return dialog.showModal();
  if (event.key === "Escape" && aim.placing) return place(aim.placing);
  const found = KEYS.find(([keys]) => keys.includes(event.key));
  if (!found) return;
  event.preventDefault();
  found[3](event);
}

function history(event) {
  const key = event.key.toLowerCase();
  if (!["z", "y"].includes(key)) return;
  event.preventDefault();
  key === "y" || event.shiftKey ? act.redo() : act.undo();
}

const list = document.getElementById("key-list");
for (const [written, what] of [...KEYS.map(([, key, effect]) => [key, effect]), ...ALWAYS]) {
  const [row, term, text] = ["div", "dt", "dd"].map((tag) => document.createElement(tag));
  const key = document.createElement("kbd");
  key.textContent = written;
  text.textContent = what;
  term.append(key);
  row.append(term, text);
  list.append(row);
}
document.getElementById("help").addEventListener("click", () => dialog.showModal());
addEventListener("keydown", down);
addEventListener("keyup", ({ key }) => release(key));
addEventListener("blur", releaseAll);
