/** Starts the page: the line to the server, the picture, the readouts beside it, the line at the foot. */

import "./above.js";
import { open } from "./connection.js";
import { part, press, write } from "./dom.js";
import { paint } from "./drawing.js";
import { computeBands } from "./bands.js";
import "./exports.js";
import * as frames from "./frames.js";
import "./keyboard.js";
import "./notices.js";
import * as panel from "./panel.js";
import * as planning from "./planning.js";
import "./pointers.js";
import * as readouts from "./readouts.js";
import { offerScenes } from "./scenes.js";
import { advance, moves, rebuild } from "./steering.js";
import * as strip from "./strip.js";
import { listen, now, publish } from "./store.js";
import "./toolbar.js";
import * as transport from "./transport.js";
import { kernel, trial } from "./trial.js";

const READOUTS = [ // beside the picture, and how often they are refreshed, ms
  { every: 100, refresh: readouts.refresh },
  { every: 100, refresh: transport.refresh },
  { every: 150, refresh: strip.draw }, // sooner once the forces have come
  { every: 200, refresh: panel.refresh },
  { every: 200, refresh: planning.refresh },
  { every: 1000, refresh: readouts.refreshDescription },
];
const STATUS_EVERY = 500; // ms
let later = 0;

/** Refresh the readouts that are due; others once they are. */
function refreshReadouts() {
  clearTimeout(later);
  if (!now.state) return;
  const t = performance.now();
  let next = Infinity;
  for (const one of READOUTS) {
    if (one.step === now.state) continue;
    const left = (one.last ?? -Infinity) + one.every - t;
    if (left > 0) next = Math.min(next, left);
    else {
      [one.last, one.step] = [t, now.state];
      one.refresh();
    }
  }
  if (next < Infinity) later = setTimeout(refreshReadouts, next);
}

/** Write whether the page is connected, and where it records. */
function refreshStatus() {
  write("line", now.connected ? "connected" : now.state ? "not connected" : "connecting …");
  part("line").classList.toggle("up", now.connected);
  write("recording", now.scene?.recording ? `recording ${now.scene.recording}` : "");
}

listen("refused", () => { // fields go back to what is
  READOUTS.forEach((one) => (one.step = null));
  refreshReadouts();
});
offerScenes(rebuild, kernel);
const everything = part("everything");
const unfold = (on) => {
  everything.ariaExpanded = String(on);
  document.querySelector("main").classList.toggle("everything", on);
};
press(everything, () => unfold(everything.ariaExpanded !== "true"));
listen("scene", ({ past }) => past.length && unfold(true)); // the needle has been steered already
kernel.then((compiled) => {
  const worker = new Worker("/page/model/band_worker.js", { type: "module" });
  computeBands(worker, compiled, () => ({ name: trial.scene.needle, steered: trial.steered }));
});
frames.start(advance, paint, moves, () => {
  refreshReadouts();
  publish("drawn");
});
setInterval(refreshStatus, STATUS_EVERY);
open();
