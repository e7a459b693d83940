/** Keys that hold a move: the newest counts, and once it is let go the one before that is still down. */

import { hold } from "./actions.js";
import { letGo } from "./steering.js";

let down = []; // [key, direction], the newest last

/** Whether a key holds a move, or would if it were the newest. */
export const holds = (key) => down.some(([one]) => one === key);

/** A key is pressed: insert (1) or retract (-1) as long as it is down. */
export function press(key, direction) {
  down.push([key, direction]);
  hold(direction);
}

/** A key is let go. */
export function release(key) {
  if (!holds(key)) return;
  const newest = down.at(-1)[0] === key;
  down = down.filter(([one]) => one !== key);
  if (!newest) return;
  if (down.length) hold(down.at(-1)[1]);
  else letGo();
}

/** Whatever is still down holds nothing any more. */
export const releaseAll = () => (down = []);
