/** Pointers and keys on the picture of a file; the wheel scrolls the page, and so does a finger up or down beside handles. */

import { part } from "../dom.js";
import { handleAt } from "../handles.js";
import { slope, degrees } from "../quantities.js";
import { now } from "../store.js";
import { fit, hold, pan, zoom } from "../view.js";
import { pin } from "../strip.js";
import { pressed } from "../toolbar.js";

const canvas = part("canvas");
const BASE = { y: 0.1, angle: 0.1 }; // mm, degrees a key
const SIDEWAYS = 12; // px, from which a finger beside handles shifts the picture
let drag = null; // {handle, from, last}

const place = (event) => {
  const { left, top } = canvas.getBoundingClientRect();
  return [event.clientX - left, event.clientY - top];
};

/** Let the picture be steered: `steer(changes)` carries a change out. */
export function listenToPicture(steer) {
  canvas.addEventListener("touchstart", (event) => {
    if (handleAt(...place(event.touches[0]), "touch")) event.preventDefault(); // the page does not scroll
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 0 || !event.isPrimary) return;
    canvas.setPointerCapture(event.pointerId);
    const at = place(event),
      handle = handleAt(...at, event.pointerType);
    drag = { handle, from: at, last: at };
    hold(handle !== null);
    canvas.classList.add("dragging");
  });
  canvas.addEventListener("pointermove", (event) => {
    const at = place(event);
    if (!event.isPrimary) return;
    if (!drag) return void (canvas.style.cursor = handleAt(...at)?.cursor ?? "");
    if (drag.handle) {
      const set = drag.handle.drag(drag.from, at);
      if (set.length) steer(set);
    } else if (event.pointerType !== "touch") pan(at[0] - drag.last[0], at[1] - drag.last[1]);
    else if (Math.abs(at[0] - drag.from[0]) > SIDEWAYS) pan(at[0] - drag.last[0], 0);
    drag.last = at;
    pressed();
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(kind, () => {
      drag = null;
      hold(false);
      canvas.classList.remove("dragging");
    });
  }
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    zoom(Math.exp(-0.002 * event.deltaY), ...place(event));
    pressed();
  }, { passive: false });
  const insertBy = (mm) => steer([["depth_mm", null, Math.min(Math.max(now.state.depth_mm + mm, 0), now.scene.length_mm - 0.01)]]);
  const base = (mm) => steer([["base_y_mm", null, now.state.base.input_y + mm]]);
  const turn = (by) => steer([["base_slope", null, slope(degrees(now.state.base.input_slope) + by)]]);
  const keys = {
    ArrowRight: ({ shiftKey }) => insertBy(shiftKey ? 0.1 : 1),
    ArrowLeft: ({ shiftKey }) => insertBy(shiftKey ? -0.1 : -1),
    ArrowUp: ({ shiftKey }) => (shiftKey ? turn(BASE.angle) : base(BASE.y)),
    ArrowDown: ({ shiftKey }) => (shiftKey ? turn(-BASE.angle) : base(-BASE.y)),
    f: () => steer([["bevel_side", null, -now.state.bevel.side]]),
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
    pressed();
  });
}
