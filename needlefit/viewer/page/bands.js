/** The band of the scene's draws about the needle that is shown; it is computed in a thread of its own. */

import { toInputs } from "./model/inputs.js";
import { listen, now, take } from "./store.js";
import { kernel, trial } from "./trial.js";

const NONE = { kind: "band", x: [] };
const worker = new Worker("/page/model/band_worker.js", { type: "module" });
let ordered = ""; // what the newest order is about
kernel.then((compiled) => worker.postMessage({ kernel: compiled }));

/** Order the band of the needle as it stands, unless it is on its way. */
function order() {
  const { scene, steered } = trial;
  if (!scene.draws) return;
  const id = { needle: scene.needle, step: steered.number };
  if (ordered === JSON.stringify(id)) return;
  ordered = JSON.stringify(id);
  const { model } = steered;
  const steps = steered.path().map((one) => ({ depth: one.depth, inputs: toInputs(one, model.pathAngle) }));
  worker.postMessage({ id, model, steps });
}

function send() {
  ordered = "";
  worker.postMessage({ draws: now.scene.draws, steps: null });
  if (now.state) order();
}

worker.onmessage = ({ data: { id, band } }) => {
  if (id.needle === trial.scene.needle) take(band ? { kind: "band", step: id.step, ...band } : NONE);
};
listen("scene", send);
listen("draws", send);
listen("state", order);
