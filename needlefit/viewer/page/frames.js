/**
 * The clock of the picture, and what each of its frames took.
 *
 * Frames are asked for as long as something moves: while a page asks for every frame, the browser holds a wheel's
 * event back for one frame longer.
 */

import { answered, awaitsAnswer, receiveForFrame } from "./connection.js";
import { listen, now } from "./store.js";

const KEPT = 8192;
const SPAN = 2000; // ms over which rates are averaged

let count = 0;
let fresh = false;
let oldestInput = null; // ms; of the inputs that the next frame is the first to show
const channel = new MessageChannel();
let drawn = null; // the record of a frame that may not be painted yet
let paint = null;
let asked = false; // whether the browser was asked for a frame that has not come yet
let began = null; // ms, when the frames began that have come without a pause since

/** Whatever runs next after a frame finds it painted; a message alone may be held up by an event. */
function mark() {
  if (!drawn) return;
  drawn.painted = performance.now();
  if (drawn.input !== null) drawn.latency_ms = drawn.painted - drawn.input;
  drawn = null;
}

channel.port1.onmessage = mark;
for (const kind of ["keydown", "keyup", "pointerdown", "pointerup"]) addEventListener(kind, mark, true);

listen("state", ({ answers }) => {
  fresh = true;
  const input = answered(answers);
  oldestInput ??= input;
});

function frame(t) {
  asked = false;
  began ??= t;
  mark();
  receiveForFrame();
  const step = now.state?.step ?? null;
  const record = { t, step, fresh, input: oldestInput, latency_ms: null, painted: null };
  paint(fresh, t);
  fresh = false;
  oldestInput = null;
  now.frames[count++ % KEPT] = record;
  drawn = record;
  channel.port2.postMessage(null); // heard once the browser is done with this frame's scripts and layout
  if (now.state?.moving || now.state?.playing || awaitsAnswer()) wake();
  else began = null;
}

/** Ask for a frame: something has to be drawn, or an answer is about to come. */
function wake() {
  if (asked || !paint) return;
  asked = true;
  requestAnimationFrame(frame);
}

/** Call `draw(fresh, t)` in every frame from now on and keep a record of it. */
export function start(draw) {
  paint = draw;
  wake();
}

for (const kind of ["state", "redraw", "sent"]) listen(kind, wake);

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
