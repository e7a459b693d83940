/** Mouse, pen and fingers on the picture: they drag handles, shift it and zoom. */

import { part } from "./dom.js";
import { handleAt } from "./handles.js";
import { change, newGesture } from "./steering.js";
import { now } from "./store.js";
import { hold, pan, zoom } from "./view.js";

const NOTCH = { 0: 100, 1: 3, 2: 1 }; // wheel units a notch, by deltaMode
const FINE = 0.1;

const canvas = part("canvas");
const fingers = new Map(); // pointers that are down, and where
/** @type {any} */
let drag = null; // {handle, from, last, to, gesture, pointer}: where it began, where the pointer is, to where it drags

/** Where an event is on the picture, px. */
export const place = (event) => {
  const { left, top } = canvas.getBoundingClientRect();
  return [event.clientX - left, event.clientY - top];
};

function down(event) {
  if (event.button > 0) return;
  canvas.setPointerCapture(event.pointerId);
  const at = place(event);
  fingers.set(event.pointerId, at);
  if (fingers.size > 1) drag = null; // two fingers pinch
  else {
    const handle = handleAt(...at, event.pointerType);
    if (handle) drag = { handle, from: at, last: at, to: at, gesture: newGesture(), pointer: event.pointerId };
  }
  canvas.classList.toggle("dragging", drag !== null);
  hold(drag !== null);
}

/** A handle follows at once: this event does not wait for the next frame, as moves do. It stays under the pointer; with Shift it goes a tenth as far. */
function follow(event) {
  if (drag?.pointer !== event.pointerId || !now.state) return;
  const at = place(event);
  drag.to = drag.to.map((to, i) => to + (event.shiftKey ? FINE : 1) * (at[i] - drag.last[i]));
  drag.last = at;
  const set = drag.handle.drag(drag.from, drag.to);
  if (set.length) change(set, { gesture: drag.gesture });
}

function moved(event) {
  const before = fingers.get(event.pointerId);
  if (!before) return hover(event);
  if (drag) return RAW ? undefined : follow(event);
  const at = place(event);
  if (fingers.size === 1) pan(at[0] - before[0], at[1] - before[1]);
  else if (fingers.size === 2) pinch(event.pointerId, before, at);
  fingers.set(event.pointerId, at);
}

function pinch(id, before, at) {
  const [other] = [...fingers].filter(([finger]) => finger !== id).map(([, at]) => at);
  const distance = ([x, y]) => Math.max(Math.hypot(x - other[0], y - other[1]), 20);
  pan((at[0] - before[0]) / 2, (at[1] - before[1]) / 2);
  zoom(distance(at) / distance(before), (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
}

function up(event) {
  if (drag?.pointer === event.pointerId) {
    if (event.type === "pointerup") follow(event); // its last place, whether or not a move reported it
    drag = null;
  }
  fingers.delete(event.pointerId);
  canvas.classList.remove("dragging");
  hold(false);
}

function hover(event) {
  const cursor = handleAt(...place(event))?.cursor ?? "";
  if (canvas.style.cursor !== cursor) canvas.style.cursor = cursor;
}

function wheel(event) {
  if (!event.ctrlKey && !event.metaKey) return;
  event.preventDefault();
  zoom(Math.exp((-0.2 * (event.deltaY || event.deltaX)) / NOTCH[event.deltaMode]), ...place(event));
}

const RAW = "onpointerrawupdate" in canvas;
const HEARD = { pointerdown: down, pointermove: moved, pointerrawupdate: follow, pointerup: up, pointercancel: up };
for (const [kind, hear] of Object.entries(HEARD)) canvas.addEventListener(kind, hear);
canvas.addEventListener("wheel", wheel, { passive: false });
