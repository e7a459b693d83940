/** The band of the scene's draws about the needle that is shown, and forces on its way; a thread of its own computes them. */

import { part } from "./dom.js";
import { toInputs } from "./model/inputs.js";
import { listen, now, take } from "./store.js";
import { kernel, trial } from "./trial.js";

const NONE = { kind: "band", x: [] };
const worker = new Worker("/page/model/band_worker.js", { type: "module" });
let ordered = ""; // what the newest order is about
kernel.then((compiled) => worker.postMessage({ kernel: compiled }));

/** The needle as it stands, as the thread is given it. */
function describeNeedle() {
  const { scene, steered } = trial;
  const { model } = steered;
  const steps = steered.path().map((one) => ({ depth: one.depth, inputs: toInputs(one, model.pathAngle) }));
  return { id: { needle: scene.needle, step: steered.number }, model, steps };
}

/** Order what is shown of the needle as it stands, unless it is on its way. */
function order() {
  const { scene, steered } = trial;
  const traced = !part("strip").hidden;
  if (!scene.draws && !traced) return;
  const about = JSON.stringify([scene.needle, steered.number, traced]);
  if (ordered === about) return;
  ordered = about;
  worker.postMessage({ ...describeNeedle(), traced });
}

function send() {
  ordered = "";
  worker.postMessage({ draws: now.scene.draws, steps: null });
  if (now.state) order();
}

worker.onmessage = ({ data: { id, band, forces, pinned } }) => {
  if (pinned) return take({ kind: "pinned forces", ...id, ...pinned });
  if (id.needle !== trial.scene.needle) return;
  if (forces) take({ kind: "forces", step: id.step, ...forces });
  else take(band ? { kind: "band", step: id.step, ...band } : NONE);
};
listen("scene", send);
listen("draws", send);
listen("state", order);
listen("strip", () => now.state && order());
listen("pinned", () => worker.postMessage({ pinned: now.pinned && describeNeedle() }));
