/** The needles of a file: read, computed with the kernel in the file, and compared with what was stored. */

import { compile } from "../../mechanics/native/needle.js";
import { part } from "./dom.js";
import { computeErrors, readTarget } from "./model/errors.js";
import { ModelError } from "./model/inputs.js";
import { SteeredNeedle } from "./model/steered.js";

const SLICE = 12; // ms that work may take at a time

/** The bytes of an element that holds a compressed stream as base64. @param {string} id */
async function unpack(id) {
  const bytes = Uint8Array.from(atob(part(id).textContent), (one) => one.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(stream).arrayBuffer();
}

/** Resolves to the data of the file and the compiled kernel. @returns {Promise<Now["data"]>} */
export async function load() {
  const [data, kernel] = await Promise.all([unpack("data"), unpack("kernel").then(compile)]);
  const { lists, ...read } = JSON.parse(new TextDecoder().decode(data)); // a list that several needles have is stored once
  for (const { scene: { draws } } of read.needles) {
    for (const name in draws) draws[name] = lists[draws[name]?.$] ?? draws[name];
  }
  return { ...read, kernel };
}

/** Carry out the steps of the scene. @param {SteeredNeedle} steered */
export function insert(steered) {
  for (const changes of steered.scene.simulation.changes) steered.apply(changes);
}

/** Replays a recording: `to(n)` carries out its first n steps, anew if it is beyond, or was `changed`. */
export class Replay {
  at = 0;
  changed = false;

  /** `places`: how far it is after each step, in a unit. @param {SteeredNeedle} steered @param {RecordedStep[]} steps @param {number[]} [places] */
  constructor(steered, steps, places = [], unit = "s") {
    this.steered = steered;
    this.steps = steps;
    this.places = places;
    this.unit = unit;
    const changes = steps.flatMap(([, changes]) => changes);
    this.returns = new Set(changes.flatMap(([name, , value]) => (name === "return_to" ? [value] : [])));
  }

  /** @param {number} n */
  to(n) {
    const { steered, steps, returns } = this;
    if (this.changed || n < this.at) {
      steered.rewind();
      Object.assign(this, { at: 0, changed: false });
    }
    for (; this.at < n; this.at += 1) {
      if (returns.has(this.at)) steered.keep();
      steered.apply(steps[this.at][1]);
    }
  }
}

/** The largest distance, mm, of a needle from the one that its run stored, or difference of an error above `same`. @param {SteeredNeedle} steered @param {Needle} needle @param {number} same */
function compareStored(steered, { errors: known, tip }, same) {
  const { scene: { measured }, session } = steered;
  if (!known || !measured?.stored) return Math.abs(steered.tipLateral - Number(tip));
  const { x, y, z } = measured.stored;
  const [points] = readTarget(session, measured.target);
  const computed = computeErrors(session, measured);
  const errors = Object.keys(known).map((name) => Math.abs(known[name] - computed?.[name]));
  return Math.max(
    ...points.flatMap((point, i) => [x, y, z].map((axis, n) => Math.abs(point[n] - axis[i]))),
    ...errors.filter((one) => one > same),
  );
}

/**
 * Compute again all that the file holds, a slice at a time.
 *
 * Resolves to {count, largest}: states that were compared, and the largest distance, mm, or difference of an error above `same`;
 * 0: the same bytes. NaN where one failed.
 *
 * @param {Now["data"]} data @param {number} same
 */
export async function prove({ needles, kernel }, same) {
  let [count, largest, since] = [0, 0, performance.now()];
  const rest = async () => {
    if (performance.now() - since < SLICE) return;
    await new Promise((done) => setTimeout(done));
    since = performance.now();
  };
  for (const needle of needles) {
    /** @param {number} distance */
    const compare = (distance) => {
      count += 1;
      largest = Math.max(largest, distance);
    };
    try {
      const steered = await SteeredNeedle.begin(kernel, needle.scene);
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
