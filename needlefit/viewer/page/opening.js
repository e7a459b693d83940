/** What a new page begins with: an insertion that moves, to the middle of its depth. */

import * as act from "./actions.js";
import { listen, now } from "./store.js";
import { offer } from "./tour.js";

const PART = 0.6; // of the scene's or the measured depth
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
  act.goTo(PART * act.ownDepth());
  moving = true;
});
