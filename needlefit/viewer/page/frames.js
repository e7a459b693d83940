/** The clock of the picture, which asks for frames as long as something changes, and what each of them took. */

import { listen, now } from "./store.js";

const KEPT = 8192;
const SPAN = 2000; // ms over which rates are averaged

let count = 0;
const channel = new MessageChannel();
let drawn = null; // the record of a frame that may not be painted yet
let paint = null;
let advance = null;
let rest = null; // what does not have to be in the frame
let goesOn = null; // whether something moves by itself
let asked = false; // whether the browser was asked for a frame that has not come yet
let began = null; // ms, when the frames began that have come without a pause since

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
  began ??= t;
  mark();
  const { fresh, input } = advance();
  paint(fresh);
  const record = { t, step: now.state?.step ?? null, band: now.band?.step ?? null, fresh, input, latency_ms: null, painted: null };
  now.frames[count++ % KEPT] = record;
  drawn = record;
  channel.port2.postMessage(null); // heard once the browser is done with this frame's scripts and layout
  if (goesOn()) wake();
  else began = null;
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

/** Frames a second since the last pause, and median latency (ms), of the last two seconds; null where there are none. */
export function rates() {
  const since = performance.now() - SPAN;
  const latencies = [];
  const running = [];
  for (let back = 1; back <= Math.min(count, KEPT); back += 1) {
    const record = now.frames[(count - back) % KEPT];
    if (record.t < since) break;
    if (began !== null && record.t >= began) running.push(record.t);
    if (record.latency_ms !== null) latencies.push(record.latency_ms);
  }
  latencies.sort((one, other) => one - other);
  const spent = running[0] - running.at(-1); // the last frame comes first
  const perSecond = spent > 0 ? (1000 * (running.length - 1)) / spent : null;
  return { perSecond, latency: latencies[latencies.length >> 1] ?? null };
}
