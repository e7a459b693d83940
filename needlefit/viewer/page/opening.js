/** What a new page begins with: an insertion that moves, to the middle of its depth. */

import * as act from "./actions.js";
import { listen } from "./store.js";

const PART = 0.6; // of the scene's or the measured depth
let begun = false;

/** A needle that nobody has moved yet is inserted, unless the user wants less motion. */
listen("state", ({ depth_mm: depth, undo }) => {
  if (begun) return;
  begun = true;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!still && depth === 0 && !undo) act.goTo(PART * act.ownDepth());
});
