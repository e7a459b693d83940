/** The thread that computes bands, and forces on the way of the tip: the newest order alone counts. */

import { Band } from "./band.js";
import { TipForces } from "./tip_forces.js";

const STALE = 100; // ms; while orders come without a pause, what is that old is completed
let newest = /** @type {any} */ ({});
/** @type {Band | null} */
let band = null;
/** @type {TipForces | null} */
let tipForces = null;
let busy = false;
let done = 0; // ms, when the last order was completed
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
  /** @type {any} */
  let order = null;
  while (order !== newest && newest.steps) {
    order = newest;
    const { kernel, model, draws, steps, planes, id } = order;
    const isOld = () => newest !== order && (newest.draws !== draws || performance.now() - done < STALE);
    tipForces ??= new TipForces(kernel);
    const forces = await tipForces.compute(model, steps, isOld, pause);
    if (isOld()) continue;
    postMessage({ id, forces });
    if (draws) {
      if (band?.draws !== draws) band = new Band(kernel, model, draws);
      const found = await /** @type {Band} */ (band).compute(steps, planes, isOld, pause);
      if (isOld()) continue;
      postMessage({ id, band: found });
    }
    done = performance.now();
  }
  busy = false;
}

onmessage = ({ data }) => {
  newest = { ...newest, ...data }; // kernel and draws are sent once
  if (!busy) work();
};
