/** The clock of the picture, and what each of its frames took. */

import { answered, receiveForFrame } from "./connection.js";
import { listen, now } from "./store.js";

const KEPT = 8192;
const SPAN = 2000; // ms over which rates are averaged

let count = 0;
let fresh = false;
let oldestInput = null; // ms; of the inputs that the next frame is the first to show
const channel = new MessageChannel();
let drawn = null; // the record of a frame that may not be painted yet

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

/** Call `paint(fresh, t)` in every frame from now on and keep a record of it. */
export function start(paint) {
  const frame = (t) => {
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
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

/** Frames a second and median latency (ms, null without input) of the last two seconds. */
export function rates() {
  const since = performance.now() - SPAN;
  const latencies = [];
  let frames = 0;
  for (let back = 1; back <= Math.min(count, KEPT); back += 1) {
    const record = now.frames[(count - back) % KEPT];
    if (record.t < since) break;
    frames += 1;
    if (record.latency_ms !== null) latencies.push(record.latency_ms);
  }
  latencies.sort((one, other) => one - other);
  return { perSecond: (1000 * frames) / SPAN, latency: latencies[latencies.length >> 1] ?? null };
}
