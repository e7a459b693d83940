/** Where the needle is steeper than the model assumes, words say so: beside the number, and once aloud. */

import { say } from "./speech.js";
import { listen, now } from "./store.js";

let told = false; // of this needle

/** What to say of a needle that is too steep; empty where it is not, and where no limit is known. */
export const steepness = ({ max_slope: slope }) => (slope > (now.scene.steep ?? Infinity)
  ? `above ${now.scene.steep}: the model assumes small slopes` : "");

listen("scene", () => (told = false));
listen("state", (state) => {
  if (told || !steepness(state)) return;
  told = true;
  say(`The needle's steepest slope is ${steepness(state)}.`);
});
