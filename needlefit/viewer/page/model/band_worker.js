/** The thread that computes bands: the newest order alone counts. */

import { Session } from "../../../mechanics/native/needle.js";
import { computeBand } from "./band.js";

let newest = /** @type {any} */ ({});
let busy = false;

onmessage = async ({ data }) => {
  newest = { ...newest, ...data }; // kernel and draws are sent once
  if (busy) return;
  busy = true;
  for (let order = /** @type {any} */ (null); order !== newest;) {
    order = newest;
    const { kernel, model, draws, steps, id } = order;
    if (draws && steps) postMessage({ id, band: computeBand(await Session.begin(kernel, model, steps[0].inputs), draws, steps) });
    await new Promise((resume) => setTimeout(resume)); // messages that have come are heard
  }
  busy = false;
};
