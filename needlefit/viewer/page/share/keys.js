/** Keys on the picture of a file; a finger on a handle drags it, beside handles it scrolls the page. */

import { part } from "../dom.js";
import { handleAt } from "../handles.js";
import { turnOver, wrap } from "../model/inputs.js";
import { place } from "../pointers.js";
import { degrees, ROLL, slope } from "../quantities.js";
import { now } from "../store.js";
import { pin } from "../strip.js";
import { fit, zoom } from "../view.js";

const BASE = { y: 0.1, angle: 0.1 }; // mm, degrees a key
const canvas = part("canvas");

canvas.addEventListener("touchstart", (event) => {
  if (handleAt(...place(event.touches[0]), "touch")) event.preventDefault(); // the page does not scroll
}, { passive: false });

/** Let keys steer the needle: `steer(changes)` carries a change out. */
export function listenToKeys(steer) {
  const insertBy = (mm) => steer([["depth_mm", null, Math.min(Math.max(now.state.depth_mm + mm, 0), now.scene.length_mm - 0.01)]]);
  const base = (mm) => steer([["base_y_mm", null, now.state.base.input_y + mm]]);
  const turn = (by) => steer([["base_slope", null, slope(degrees(now.state.base.input_slope) + by)]]);
  const keys = {
    ArrowRight: ({ shiftKey }) => insertBy(shiftKey ? 0.1 : 1),
    ArrowLeft: ({ shiftKey }) => insertBy(shiftKey ? -0.1 : -1),
    ArrowUp: ({ shiftKey }) => (shiftKey ? turn(BASE.angle) : base(BASE.y)),
    ArrowDown: ({ shiftKey }) => (shiftKey ? turn(-BASE.angle) : base(-BASE.y)),
    f: () => steer([turnOver(now.state.bevel.roll_deg)]),
    r: () => steer([["bevel_roll_deg", null, wrap(now.state.bevel.roll_deg + ROLL)]]),
    R: () => steer([["bevel_roll_deg", null, wrap(now.state.bevel.roll_deg - ROLL)]]),
    k: pin,
    1: () => fit("whole"),
    2: () => fit("tissue"),
    3: () => fit("tip"),
    "+": () => zoom(1.25),
    "-": () => zoom(0.8),
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
    event.preventDefault();
    keys[event.key](event);
  });
}
