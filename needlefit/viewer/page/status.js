/** The line at the foot: whether the page is connected, how fast it draws, how fast the solver is. */

import { rates } from "./frames.js";
import { grouped } from "./numbers.js";
import { now } from "./store.js";

const part = (id) => document.getElementById(id);

function write(id, text) {
  if (part(id).textContent !== text) part(id).textContent = text;
}

/** Write what has changed. */
export function refresh() {
  const { perSecond, latency } = rates();
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
