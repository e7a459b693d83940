/** The band of the scene's draws about the needle that is shown; a thread of its own computes it. */

import { listen, now, take } from "./store.js";

/** Have a worker compute it. @param {Worker} worker */
export function computeBands(worker) {
  let ordered = ""; // what the newest order is about
  worker.postMessage({ kernel: now.data.kernel });

  /** The needle and its step, by which an answer is known. */
  const about = () => ({ needle: now.data.needles.indexOf(now.needle), step: now.state.step });

  /** Order what is shown of the needle as it stands, unless it is on its way. */
  function order() {
    if (!now.state || ordered === JSON.stringify(about())) return;
    ordered = JSON.stringify(about());
    const { session } = now.steered;
    worker.postMessage({ id: about(), model: session.model, steps: session.path() });
  }

  worker.onmessage = ({ data: { id, band } }) => {
    if (id.needle === about().needle) take("band", band && { step: id.step, ...band });
  };
  listen("scene", ({ draws }) => {
    ordered = "";
    worker.postMessage({ draws, steps: null });
  });
  listen("drawn", order); // not before: the thread that wakes would hold up the frame
}
