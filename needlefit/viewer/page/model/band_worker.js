/** The thread that computes bands: the newest order alone counts. */

import { computeBand } from "./band.js";

let newest = null;
let busy = false;
const channel = new MessageChannel();
const waiting = [];
channel.port1.onmessage = () => waiting.shift()();

/** Let messages that have come be heard. */
const pause = () => new Promise((done) => {
  waiting.push(done);
  channel.port2.postMessage(null);
});

async function work() {
  busy = true;
  for (let order = newest; order; order = newest === order ? null : newest) {
    const { kernel, model, draws, steps, id } = order;
    const band = await computeBand(kernel, model, draws, steps, () => newest !== order, pause);
    if (newest === order) postMessage({ id, band });
  }
  busy = false;
}

onmessage = ({ data }) => {
  newest = { ...newest, ...data }; // kernel and draws are sent once
  if (!busy) work();
};
