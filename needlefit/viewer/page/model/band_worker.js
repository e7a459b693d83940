/** The thread that computes bands: the newest order alone counts. */

import { Band } from "./band.js";

const STALE = 100; // ms; while orders come without a pause, a band that old is completed
let newest = {};
let band = null;
let busy = false;
let done = 0; // ms, when the last band was completed
const channel = new MessageChannel();
const waiting = [];
channel.port1.onmessage = () => waiting.shift()();

/** Let messages that have come be heard. */
const pause = () => new Promise((resume) => {
  waiting.push(resume);
  channel.port2.postMessage(null);
});

async function work() {
  busy = true;
  let order = null;
  while (order !== newest && newest.steps && newest.draws) {
    order = newest;
    const { kernel, model, draws, steps, id } = order;
    if (band?.draws !== draws) band = new Band(kernel, model, draws);
    const isOld = () => newest !== order && (newest.draws !== draws || performance.now() - done < STALE);
    const found = await band.compute(steps, isOld, pause);
    if (isOld()) continue;
    done = performance.now();
    postMessage({ id, band: found });
  }
  busy = false;
}

onmessage = ({ data }) => {
  newest = { ...newest, ...data }; // kernel and draws are sent once
  if (!busy) work();
};
