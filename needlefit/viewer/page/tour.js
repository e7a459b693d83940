/** What happens by itself: a new needle is inserted, and a new reader is shown three things to try. */

import { part, press, say } from "./dom.js";
import * as act from "./actions.js";
import { invalidate } from "./drawing.js";
import { listen, now } from "./store.js";
import { move } from "./steering.js";
import { pressed } from "./toolbar.js";
import { trial } from "./trial.js";
import { fit, view } from "./view.js";

const SEEN = "needlefit.tour";
const [MOVED, INSERTED] = [0.5, 5]; // mm that the base, or the depth, must change by

/** What to do, the handle that does it, its button, the view that shows it, and when it is done since a state. */
const STEPS = [
  {
    words: "Turn the bevel over: drag the red knob at its tip to the other side (or press F).",
    hint: "bevel", button: "flip", shows: "tissue", done: (from, to) => from.bevel.side !== to.bevel.side,
  },
  {
    words: "Move the base: drag it up or down (or press ↑ ↓). The needle bends.",
    hint: "across", shows: "whole", done: (from, to) => Math.abs(to.base.input_y - from.base.input_y) >= MOVED,
  },
  {
    words: "Push on: drag the base to the right (or hold Insert, or →). The tip takes its new way.",
    hint: "along", button: "insert", shows: "whole", done: (from, to) => to.depth_mm > from.depth_mm + INSERTED,
  },
];
let step = -1;
let [from, before, scene] = [null, null, null]; // the state as the step began, the view before the tour, the scene of both

function show(next) {
  if (step < 0) before = view.fit;
  part(STEPS[step]?.button ?? "flip").classList.remove("hint");
  step = next < STEPS.length ? next : -1;
  const { words, hint = null, button, shows = before } = STEPS[step] ?? {};
  [from, scene, now.hint] = [now.state, now.scene, hint];
  part("tour").hidden = step < 0;
  fit(shows);
  pressed();
  invalidate();
  if (step < 0) return;
  localStorage.setItem(SEEN, "yes");
  part("tour-text").textContent = `${step + 1} of ${STEPS.length}: ${words}`;
  if (button) part(button).classList.add("hint");
  say(words);
  part("tour").scrollIntoView({ block: "nearest" });
}

/** Go on once a step is done, by the user and this needle; not while something is dragged, since the view may change. */
function goOn() {
  const alone = movesAlone();
  if (step < 0) return;
  if (scene !== now.scene) [scene, from] = [now.scene, now.state];
  if (alone) from = { ...from, depth_mm: now.state.depth_mm };
  if (part("canvas").classList.contains("dragging")) return;
  if (STEPS[step].done(from, now.state)) show(step + 1);
}

listen("state", goOn);
addEventListener("pointerup", () => setTimeout(goOn));
press("tour-skip", () => show(step + 1));
press("tour-end", () => show(STEPS.length));
press("tour-begin", () => {
  part("keys").close();
  show(0);
});

/** Begin on the first page of this browser, once its needle stands. */
export function offer() {
  if (!localStorage.getItem(SEEN)) show(0);
}

const FAST = 200; // mm/s, of a needle that was inserted before
let begun = false;
let again = null; // {scene, depth}: a needle shown instead of that scene's is inserted to the depth, mm
let own = null; // the gesture of an insertion that nobody asked for by hand

/** Insert to a depth, mm, by itself. */
function insertAlone(speed, depth) {
  move(speed, depth);
  own = trial.motion?.gesture ?? null;
}

/** Whether the needle has moved by itself up to this state. */
function movesAlone() {
  const gesture = trial.motion?.gesture ?? null;
  const alone = own !== null && (gesture === own || gesture === null);
  if (gesture !== own) own = null; // it has come to its end, or a hand is on the needle
  return alone;
}

/** Insert the needle that is shown next to this depth, mm, if it is a new one. */
export function insertAgain(depth) {
  again = { scene: now.scene, depth };
}

/** A new needle is inserted: the first one, unless the user wants less motion. */
listen("state", ({ depth_mm: depth, undo }) => {
  const fresh = depth === 0;
  if (again && again.scene !== now.scene) {
    if (fresh && again.depth > 0) insertAlone(FAST, again.depth);
    again = null;
  }
  if (begun) return;
  begun = true;
  if (!fresh || undo || matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  insertAlone(act.speed(), act.ownDepth());
  offer();
});
listen("refused", () => (again = null));
