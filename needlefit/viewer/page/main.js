/** Starts the page: the line to the server, the picture, the readouts beside it, the line at the foot. */

import { open } from "./connection.js";
import { part, write } from "./dom.js";
import { paint } from "./drawing.js";
import "./bands.js";
import "./exports.js";
import * as frames from "./frames.js";
import "./keyboard.js";
import "./live_fit.js";
import "./notices.js";
import "./strip.js";
import * as panel from "./panel.js";
import * as planning from "./planning.js";
import "./pointers.js";
import { grouped } from "./quantities.js";
import * as readouts from "./readouts.js";
import { advance, moves } from "./steering.js";
import { listen, now } from "./store.js";
import "./toolbar.js";
import "./tour.js";
import "./tracking.js";
import * as transport from "./transport.js";

const READOUTS = [ // beside the picture, and how often they are refreshed, ms
  { every: 100, refresh: readouts.refresh },
  { every: 100, refresh: transport.refresh },
  { every: 200, refresh: panel.refresh },
  { every: 200, refresh: planning.refresh },
  { every: 1000, refresh: readouts.refreshDescription },
];
const STATUS_EVERY = 500; // ms
const BETWEEN = 20; // ms between two readouts that no frame refreshes
let later = 0;

/** Refresh one readout that is due in a frame, so that no frame has to wait for all of them; others soon after it. */
function refreshOne(t) {
  clearTimeout(later);
  if (!now.state) return;
  const waiting = READOUTS.filter((one) => one.step !== now.state);
  const due = waiting.find((one) => t - (one.last ?? -Infinity) >= one.every);
  if (waiting.length) later = setTimeout(() => refreshOne(performance.now()), BETWEEN);
  if (!due) return;
  due.last = t;
  due.step = now.state;
  due.refresh();
}

/** Write whether the page is connected, how fast it draws, how fast the solver is. */
function refreshStatus() {
  const { perSecond, latency } = frames.rates();
  write("line", now.connected ? "connected" : now.state ? "not connected" : "connecting …");
  part("line").classList.toggle("up", now.connected);
  write("frame-rate", perSecond === null ? "" : `${perSecond.toFixed(0)} frames/s`);
  write("latency", latency === null ? "" : `input to picture ${latency.toFixed(0)} ms`);
  if (!now.state) return;
  const { steps, rate_per_s: rate, failed } = now.state.solver;
  write("solver", `${grouped(steps)} solver steps${failed ? `, ${failed} failed` : ""}`);
  write("solver-rate", rate ? `solver can do ${grouped(rate)} steps/s` : "");
  write("recording", now.scene?.recording ? `recording ${now.scene.recording}` : "");
}

listen("stage", ({ what }) => write("waiting", `${what} …`));
listen("refused", () => { // fields go back to what is
  READOUTS.forEach((one) => (one.step = null));
  refreshOne(performance.now());
});
frames.start(advance, (fresh, t) => {
  paint(fresh);
  refreshOne(t);
}, moves);
setInterval(refreshStatus, STATUS_EVERY);
open();
