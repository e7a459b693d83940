/** The band of the scene's draws about the needle that is shown; a thread of its own computes it. */

import { toInputs } from "./model/inputs.js";
import { listen, now, take } from "./store.js";

const NONE = { kind: "band", x: [] };

/** Have a worker compute it; `current()` returns the needle, `steered`, and its `name`, which no other one has. */
export function computeBands(worker, kernel, current) {
  let ordered = ""; // what the newest order is about
  worker.postMessage({ kernel });

  /** The needle as it stands, as the thread is given it. */
  function describeNeedle() {
    const { name, steered } = current();
    const { model } = steered;
    const steps = steered.path().map((one) => ({ depth: one.depth, inputs: toInputs(one, model.pathAngle) }));
    return { id: { needle: name, step: now.state.step }, model, steps };
  }

  /** Order what is shown of the needle as it stands, unless it is on its way. */
  function order() {
    if (!now.state) return;
    const about = JSON.stringify([current().name, now.state.step]);
    if (ordered === about) return;
    ordered = about;
    worker.postMessage(describeNeedle());
  }

  function send() {
    ordered = "";
    worker.postMessage({ draws: now.scene.draws, steps: null });
    order();
  }

  worker.onmessage = ({ data: { id, band } }) => {
    if (id.needle === current().name) take(band ? { kind: "band", step: id.step, ...band } : NONE);
  };
  listen("scene", send);
  listen("drawn", order); // not before: the thread that wakes would hold up the frame
}
