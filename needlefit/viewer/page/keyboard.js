/** The keyboard: what each key does, the list of it, and which keys a control needs for itself. */

import * as act from "./actions.js";
import { aim, place } from "./aim.js";
import { DEFINITIONS } from "./definitions.js";
import { element, entry, part, press as onPress } from "./dom.js";
import { ROLL } from "./quantities.js";
import { describe } from "./readouts.js";
import { halt, letGo } from "./steering.js";
import { now } from "./store.js";
import { pin } from "./strip.js";
import { fit, zoom } from "./view.js";

const MOVES = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];
const FINDS = /^[\p{L}\p{N} _./-]$/u; // what finds an entry of a list as it is typed

/** Keys as the browser calls them, what is written for them, and what they do. @type {[string[], string, string, (event: any) => void][]} */
const KEYS = [
  [["ArrowRight"], "→", "insert, held; with Shift by 0.1 mm", (e) => along(e, 1)],
  [["ArrowLeft"], "←", "retract, held; with Shift by 0.1 mm", (e) => along(e, -1)],
  [["ArrowUp"], "↑", "base up by 0.1 mm; with Shift by 1 mm", (e) => act.nudgeBase(steps(e), e.timeStamp)],
  [["ArrowDown"], "↓", "base down, likewise", (e) => act.nudgeBase(-steps(e), e.timeStamp)],
  [["f", "F"], "F", "flip the bevel", (e) => e.repeat || act.flip(e.timeStamp)],
  [["r", "R"], "R", `roll the bevel by ${ROLL}°; with Shift back`, (e) => act.roll(e.shiftKey ? -ROLL : ROLL, e.timeStamp)],
  [["g", "G"], "G", "add a guide", (e) => e.repeat || act.addGuide()],
  [["t", "T"], "T", "hold the tip, let go of it", (e) => e.repeat || act.toggleTip(e.timeStamp)],
  [[" "], "space", "stop", () => ((holding = []), halt())],
  [["k", "K"], "K", "pin this needle to compare with, or unpin", (e) => e.repeat || pin()],
  [["p", "P"], "P", "play the scene", (e) => e.repeat || act.play()],
  [["d", "D"], "D", "say where the needle stands", () => describe()],
  [["+", "="], "+", "zoom in", () => zoom(1.25)],
  [["-", "_"], "−", "zoom out", () => zoom(0.8)],
  [["0", "1"], "0, 1", "show the whole needle", () => fit("whole")],
  [["2"], "2", "show the tissue", () => fit("tissue")],
  [["3"], "3", "follow the tip", () => fit("tip")],
];
const ALWAYS = [["Esc", "no target, no obstacle after all"], ["Ctrl+Z", "undo"], ["Ctrl+Y", "redo; Ctrl+Shift+Z does the same"], ["?", "this list"]];

const dialog = part("keys");
const typed = new WeakSet(); // fields with something typed that does not count yet
let holding = []; // [key, direction] of keys that hold a move: the newest, the last, counts
const steps = (event) => (event.shiftKey ? 10 : 1);

/** Whether a key belongs to what has the focus: a slider's arrows, a list's letters, all that is typed. */
function belongs({ target, key, ctrlKey, metaKey }) {
  const command = ctrlKey || metaKey;
  if (target.matches("input[type=range]")) return !command && MOVES.includes(key);
  if (target.matches("select")) return !command && (MOVES.includes(key) || FINDS.test(key));
  if (target.closest("button, summary")) return key === " "; // it presses that
  if (command && ["z", "y"].includes(key.toLowerCase()) && target.matches("input") && !typed.has(target)) return false;
  return target.matches("input, textarea");
}

/** Insert (1) or retract (-1) as long as the key is down. */
function along({ key, shiftKey, repeat, timeStamp }, direction) {
  if (holding.some(([one]) => one === key)) return; // it is repeated
  if (shiftKey) return act.insert(0.1 * direction, timeStamp);
  if (repeat) return;
  holding.push([key, direction]);
  act.hold(direction);
}

/** Once the newest key is let go, the one before that is still down holds. */
function release({ key }) {
  const newest = holding.at(-1)?.[0] === key;
  holding = holding.filter(([one]) => one !== key);
  if (!newest) return;
  if (holding.length) act.hold(holding.at(-1)[1]);
  else letGo();
}

function openHelp() {
  part("terms").replaceChildren(...Object.entries(DEFINITIONS).map(([name, text]) => entry(name, text)));
  dialog.showModal();
}

function press(event) {
  if (dialog.open || !now.state || event.altKey || belongs(event)) return;
  const key = event.key.toLowerCase();
  if (event.ctrlKey || event.metaKey) {
    if (!["z", "y"].includes(key)) return;
    event.preventDefault();
    key === "y" || event.shiftKey ? act.redo() : act.undo();
    return;
  }
  if (key === "?") return openHelp();
  if (event.key === "Escape" && aim.placing) return place(aim.placing);
  const found = KEYS.find(([keys]) => keys.includes(event.key));
  if (!found) return;
  event.preventDefault();
  found[3](event);
}

for (const [written, what] of [...KEYS.map(([, key, effect]) => [key, effect]), ...ALWAYS]) {
  part("key-list").append(entry(element("kbd", {}, written), what));
}
onPress("help", openHelp);
addEventListener("input", ({ target }) => typed.add(target), true);
for (const kind of ["change", "focusout"]) addEventListener(kind, ({ target }) => typed.delete(target), true);
addEventListener("keydown", press);
addEventListener("keyup", release);
addEventListener("blur", () => (holding = []));
