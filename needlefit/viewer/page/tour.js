/** Three things to try on a new page, one after the other; each can be skipped. */

import { say } from "./announcements.js";
import { listen, now } from "./store.js";

const SEEN = "needlefit.tour";
const MOVED = 0.5; // mm that the base or the tip must go

/** What to do, where, and when it is done given the state at its beginning. */
const STEPS = [
  ["Turn the bevel over: press Flip bevel, or F.", "flip", (from, to) => from.bevel.side !== to.bevel.side],
  ["Push on: hold Insert, or →. The tip turns to the other side.", "insert", (from, to) => to.depth_mm > from.depth_mm + 5],
  [
    "Move the base: drag it (view Needle), or press ↑ ↓. The tip goes the other way, about the tissue.",
    "canvas", (from, to) => Math.abs(to.base.input_y - from.base.input_y) >= MOVED,
  ],
];
const part = (id) => document.getElementById(id);
let step = -1;
let from = null;

function show(next) {
  part(STEPS[step]?.[1] ?? "flip").classList.remove("hint");
  step = next;
  from = now.state;
  part("tour").hidden = step < 0;
  if (step < 0) return localStorage.setItem(SEEN, "yes");
  const [words, where] = STEPS[step];
  part("tour-text").textContent = `${step + 1} of ${STEPS.length}: ${words}`;
  part(where).classList.add("hint");
  say(words);
}

listen("state", (state) => {
  if (step < 0) return;
  if (STEPS[step][2](from, state)) show(step + 1 < STEPS.length ? step + 1 : -1);
});
part("tour-skip").addEventListener("click", () => show(step + 1 < STEPS.length ? step + 1 : -1));
part("tour-end").addEventListener("click", () => show(-1));
part("tour-begin").addEventListener("click", () => {
  part("keys").close();
  show(0);
});

/** Begin on the first page of this browser, once its needle stands. */
export function offer() {
  if (!localStorage.getItem(SEEN)) show(0);
}
