/** Force on the tip at each constraint point, on the shortest way to where a needle stands: what its inputs give. */

import { Session } from "../../../mechanics/native/needle.js";
import { findWay } from "./band.js";

const CHUNK = 20; // points that are reached before a newer order is looked for
const SAME = 1e-9; // mm; depths that differ by less are one

/** A needle that goes on from where it stands, so that a small step costs little. */
export class TipForces {
  kernel; model; path; points;
  /** @type {any} */
  session;

  constructor(kernel) {
    Object.assign(this, { kernel, model: "", path: null, points: [] });
  }

  /** Resolves to {x, y}: depths, mm, and the forces there, N; null where `cancelled()`. Steps and `pause` as of Band. */
  async compute(model, steps, cancelled, pause) {
    const path = steps.map((one) => ({ ...one, text: JSON.stringify(one.inputs) }));
    const same = this.model === JSON.stringify(model);
    let way = this.path && same && findWay(this.path, path);
    if (!way) await this.#begin(model, steps[0].inputs);
    way ||= path;
    this.path = null; // while it is under way
    let reached = 0;
    for (const { depth, inputs } of way) {
      if (depth < this.session.depth - SAME) this.points = this.points.filter((one) => one.depth <= depth + SAME);
      for (const stop of this.#listStops(depth)) {
        this.session.go(stop, inputs);
        if (this.session.failed) return this.#read(); // up to there
        this.#add();
        reached += 1;
        if (reached % CHUNK) continue;
        await pause();
        if (cancelled()) return null;
      }
      this.session.go(depth, inputs);
    }
    this.path = path;
    return this.#read();
  }

  async #begin(model, inputs) {
    if (this.session) this.session.again(model, [{ depth: 0, inputs }]);
    else this.session = await Session.begin(this.kernel, model, inputs);
    [this.model, this.points] = [JSON.stringify(model), []];
    this.#add();
  }

  /** The depths of constraint points beyond the tip, up to a depth, mm. */
  #listStops(depth) {
    const { model: { firstCell, spacing }, depth: from } = this.session;
    const first = from < firstCell - SAME ? 0 : Math.floor((from - firstCell + SAME) / spacing) + 1;
    const count = Math.floor((depth - firstCell + SAME) / spacing) + 1 - first;
    return Array.from({ length: Math.max(count, 0) }, (_, n) => Math.min(firstCell + (first + n) * spacing, depth));
  }

  #add() {
    const { session } = this;
    this.points.push({ depth: session.depth, force: session.forces().tipForce });
  }

  #read() {
    return { x: this.points.map(({ depth }) => depth), y: this.points.map(({ force }) => force) };
  }
}
