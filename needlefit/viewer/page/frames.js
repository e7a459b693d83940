/** The clock of the picture, which asks for frames as long as something changes, and what each of them took. */

import { listen, now } from "./store.js";

const KEPT = 8192;

let count = 0;
const channel = new MessageChannel();
let drawn = null; // the record of a frame that may not be painted yet
let paint = null;
let advance = null;
let rest = null; // what does not have to be in the frame
let goesOn = null; // whether something moves by itself
let asked = false; // whether the browser was asked for a frame that has not come yet

/** Whatever runs next after a frame finds it painted; a message alone may be held up by an event. */
function mark() {
  if (!drawn) return;
  drawn.painted = performance.now();
  if (drawn.input !== null) drawn.latency_ms = drawn.painted - drawn.input;
  drawn = null;
}

channel.port1.onmessage = () => {
  mark();
  rest();
};
for (const kind of ["keydown", "keyup", "pointerdown", "pointerup"]) addEventListener(kind, mark, true);

function frame(t) {
  asked = false;
  mark();
  const { fresh, input } = advance();
  paint(fresh);
  const record = { t, step: now.state?.step ?? null, band: now.band?.step ?? null, fresh, input, latency_ms: null, painted: null };
  now.frames[count++ % KEPT] = record;
  drawn = record;
  channel.port2.postMessage(null); // heard once the browser is done with this frame's scripts and layout
  if (goesOn()) wake();
}

/** Ask for a frame: something has to be drawn, or an answer is about to come. */
function wake() {
  if (asked || !paint) return;
  asked = true;
  requestAnimationFrame(frame);
}

/**
 * In every frame from now on call `move()`, which returns whether there is a new state and when its oldest input
 * happened, ms, then `picture(fresh)`; once that is drawn, `others()`. Frames go on by themselves while `moves()`.
 */
export function start(move, picture, moves, others) {
  [advance, paint, goesOn, rest] = [move, picture, moves, others];
  wake();
}

for (const kind of ["redraw", "moved"]) listen(kind, wake);
