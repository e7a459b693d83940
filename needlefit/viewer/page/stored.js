/** The needles of a file: read, computed with the kernel in the file, and compared with what was stored. */

import { compile } from "../../mechanics/native/needle.js";
import { part } from "./dom.js";
import { computeErrors, readTarget } from "./model/errors.js";
import { ModelError } from "./model/inputs.js";
import { SteeredNeedle } from "./model/steered.js";

const SLICE = 12; // ms that work may take at a time

/** The bytes of an element that holds a compressed stream as base64. */
async function unpack(id) {
  const bytes = Uint8Array.from(atob(part(id).textContent), (one) => one.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(stream).arrayBuffer();
}

/** Resolves to the data of the file and the compiled kernel. */
export async function load() {
  const [data, kernel] = await Promise.all([unpack("data"), unpack("kernel").then(compile)]);
  const { lists, ...read } = JSON.parse(new TextDecoder().decode(data));
  const resolve = (value) => (Array.isArray(value?.$) || Number.isInteger(value?.$) ? lists[value.$] : value);
  for (const { scene } of read.needles) {
    if (!scene.draws) continue;
    for (const name of ["mu", "law", "strength"]) scene.draws[name] = resolve(scene.draws[name]);
  }
  return { ...read, kernel };
}

/** Resolves to a needle at first contact. */
export const begin = (kernel, { scene }) => SteeredNeedle.begin(kernel, scene);

/** Carry out the steps of the scene. */
export function insert(steered) {
  for (const changes of steered.scene.simulation.changes) steered.apply(changes);
}

/** Replays a recording: `to(n)` carries out its first n steps, from the beginning if it is beyond, or `changed` by the reader. */
export class Replay {
  steered; steps; at; changed; last; places = []; unit = "s";

  constructor(steered, steps) {
    Object.assign(this, { steered, steps, at: 0, changed: false, last: new Map() });
    this.steps.forEach(([, changes], i) => {
      for (const [name, , value] of changes) if (name === "return_to") this.last.set(value, i + 1);
    });
  }

  to(n) {
    if (this.changed || n < this.at) {
      this.steered.rewind();
      Object.assign(this, { at: 0, changed: false });
    }
    while (this.at < n) this.#next();
  }

  #next() {
    const [, changes] = this.steps[this.at];
    this.steered.apply(changes);
    this.at += 1;
    if (this.last.has(this.at)) this.steered.keep();
    for (const [name, , value] of changes) {
      if (name === "return_to" && this.last.get(value) === this.at) this.steered.forget(value);
    }
  }
}

/** The largest distance, mm, of a needle of a report from the one that its run stored, or difference of an error above `same`; 0: the same bytes. */
function compareStored(steered, { errors: known, tip }, same) {
  if (!known) return Math.abs(steered.tipLateral - tip);
  const { target, stored } = steered.scene.measured;
  const [points] = readTarget(steered.session, target);
  const found = computeErrors(steered.session, steered.scene.measured);
  const errors = Object.keys(known).map((name) => Math.abs(known[name] - found[name]));
  return Math.max(
    ...points.flatMap((point, i) => ["x", "y", "z"].map((axis, n) => Math.abs(point[n] - stored[axis][i]))),
    ...errors.filter((one) => one > same),
  );
}

/**
 * Compute again all that the file holds, a slice at a time.
 *
 * Resolves to {count, largest}: states that were compared, and the largest distance, mm, or difference of an error above `same`;
 * 0: the same bytes. NaN where one failed.
 */
export async function prove({ needles, kernel }, same) {
  let [count, largest, since] = [0, 0, performance.now()];
  const rest = async () => {
    if (performance.now() - since < SLICE) return;
    await new Promise((done) => setTimeout(done));
    since = performance.now();
  };
  for (const needle of needles) {
    const compare = (distance) => {
      count += 1;
      largest = Math.max(largest, distance);
    };
    try {
      const steered = await begin(kernel, needle);
      if (needle.recording) {
        const replay = new Replay(steered, needle.recording);
        for (let n = 1; n <= needle.recording.length; n += 1) {
          replay.to(n);
          compare(Math.abs(steered.tipLateral - needle.recording[n - 1][2]));
          await rest();
        }
      } else {
        insert(steered);
        if (needle.tip === null) continue; // the model finds no needle at its end
        compare(compareStored(steered, needle, same));
      }
    } catch (error) {
      if (!(error instanceof ModelError)) throw error;
      compare(NaN);
    }
    await rest();
  }
  return { count, largest };
}
