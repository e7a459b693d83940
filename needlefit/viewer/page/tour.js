/** What a new page begins with: an insertion that moves, then three things to try. */

import { part, press, say } from "./dom.js";
import * as act from "./actions.js";
import { invalidate } from "./drawing.js";
import { listen, now } from "./store.js";
import { pressed } from "./toolbar.js";
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
let [from, before] = [null, null]; // the state as the step began, the view before the tour

function show(next) {
  if (step < 0) before = view.fit;
  part(STEPS[step]?.button ?? "flip").classList.remove("hint");
  step = next < STEPS.length ? next : -1;
  const { words, hint = null, button, shows = before } = STEPS[step] ?? {};
  [from, now.hint] = [now.state, hint];
  part("tour").hidden = step < 0;
  fit(shows);
  pressed();
  invalidate();
  if (step < 0) return;
  localStorage.setItem(SEEN, "yes");
  part("tour-text").textContent = `${step + 1} of ${STEPS.length}: ${words}`;
  if (button) part(button).classList.add("hint");
  say(words);
  uncover();
}

/** In a low window the picture goes to the top, where nothing covers it. */
function uncover() {
  const [picture, tour] = ["picture", "tour"].map((id) => part(id).getBoundingClientRect());
  if (picture.bottom > tour.top && picture.top < tour.top) scrollBy(0, picture.top);
}

/** Go on once a step is done; not while something is dragged, since the view may change. */
function goOn() {
  if (step < 0 || part("canvas").classList.contains("dragging")) return;
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

let begun = false;
let moving = false; // until the first insertion has come to its end

/** A needle that nobody has moved yet is inserted, unless the user wants less motion, or a tracker moves it. */
listen("state", ({ depth_mm: depth, undo, moving: speed }) => {
  if (moving && depth > 0 && !speed) {
    moving = false;
    offer();
  }
  if (begun) return;
  begun = true;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (still || now.scene.tracked || depth !== 0 || undo) return;
  act.goTo(act.ownDepth());
  moving = true;
});
