/** The needle of a scene, simulated step by step: the same changes find the same bits as `SteeredNeedle` in Python. */

import { Session } from "../../../mechanics/native/needle.js";
import { applyChanges, checkChange, ModelError } from "./inputs.js";

const BEARABLE = "a load that tissue and needle can bear";

/** The law of all layers for shape parameters (rows of layers), or null: only the program can compute it. @param {Law} law @param {number[][]} shape */
function makeLaw({ terms, tables }, shape) {
  if (!terms) return tables.find(([known]) => JSON.stringify(known) === JSON.stringify(shape))?.[1] ?? null;
  const layers = shape[0]?.length ?? terms.layers;
  return Array.from({ length: layers }, (_, layer) => terms.at_zero.map((value, j) => {
    const by = terms.slopes.findIndex((row) => row[j]);
    return by < 0 ? value : value + shape[by][layer] * terms.slopes[by][j];
  })).flat();
}

export class SteeredNeedle {
  /** Begin at first contact. @param {WebAssembly.Module} kernel @param {Scene} scene */
  static async begin(kernel, scene) {
    const { model, steps } = scene.simulation;
    return new SteeredNeedle(scene, await Session.begin(kernel, model, steps[0].inputs));
  }

  way = /** @type {Way | null} */ (null); // the newest of the changes that led here
  number = 0;
  saved = /** @type {Map<number, Saved>} */ (new Map());

  /** @param {Scene} scene @param {Session} session */
  constructor(scene, session) {
    this.scene = scene;
    this.session = session;
    this.rules = scene.simulation.rules;
    this.names = scene.guide_names;
    this.keep();
  }

  get model() {
    return this.session.model;
  }

  /** The greatest depth that is possible under controls, mm: the base is then just before guides or tissue. */
  reach() {
    const [first] = this.session.inputs.guides;
    return this.model.length + (first && first.x < 0 ? first.x - this.rules.clearance_mm : 0) - 1e-6;
  }

  /** The place of the tip, y in mm, as a recording has it. */
  get tipLateral() {
    return this.session.positions([this.session.shape.depth])[1];
  }

  /** All changes that led here from first contact, without those that were undone by a return. */
  listWay() {
    const ways = [];
    for (let way = this.way; way; way = way.before) ways.push(way);
    return ways.reverse();
  }

  keep() {
    if (!this.saved.has(this.number)) this.saved.set(this.number, { way: this.way, session: this.session.save() });
  }

  /** Return to first contact, as if nothing had been carried out. */
  rewind() {
    const first = /** @type {Saved} */ (this.saved.get(0));
    this.#return(first);
    Object.assign(this, { number: 0, saved: new Map([[0, first]]) });
  }

  /** @param {Saved} saved */
  #return({ session, way }) {
    this.session.restore(session);
    this.way = way;
  }

  /** The shape parameters after changes. @param {Change[]} changes */
  shapeAfter(changes) {
    const shape = this.model.shape.map((row) => [...row]);
    for (const [name, item, value] of changes) {
      const row = this.scene.shape_parameters.findIndex((one) => one.name === name);
      if (row >= 0 && item) shape[row][item - 1] = value;
    }
    return shape;
  }

  /**
   * Carry out one step: all changes [name, item, value] at once.
   *
   * A ModelError if the model does not take them, or finds no needle; then nothing has happened. A step that leads
   * outside the model's validity is carried out.
   *
   * @param {Change[]} changes
   */
  apply(changes) {
    for (const [i, change] of changes.entries()) {
      checkChange(change, this.rules);
      const [name, item] = change;
      if (changes.slice(0, i).some(([one, other]) => one === name && other === item))
        throw new ModelError(`${name} has two values in one step`, "one value for each input");
      if (name === "return_to" && changes.length > 1)
        throw new ModelError("return_to stands beside other inputs", "a step of its own");
    }
    if (changes[0]?.[0] === "return_to") {
      const saved = this.saved.get(changes[0][2]);
      if (!saved) throw new ModelError(`nothing was kept of step ${changes[0][2]}`, "a step to return to");
      this.#return(saved);
    } else {
      this.#advance(changes);
      this.way = { changes, tip: this.tipLateral, before: this.way };
    }
    this.number += 1;
  }

  /** @param {Change[]} changes */
  #advance(changes) {
    const parameters = changes.filter(([name]) => this.rules.inputs[name].parameter);
    const others = changes.filter(([name]) => !this.rules.inputs[name].parameter);
    if (!parameters.length) return this.#move(others);
    const before = this.session.save();
    try {
      this.#simulateAgain(parameters);
      this.#move(others);
    } catch (error) {
      this.session.restore(before);
      throw error;
    }
  }

  /** @param {Change[]} parameters */
  #simulateAgain(parameters) {
    const { model, session, scene } = this;
    const mu = [...model.mu];
    let strength = /** @type {number | null} */ (null);
    for (const [name, item, value] of parameters) {
      if (item && item > mu.length) throw new ModelError(`there is no layer ${item}`, `one of ${mu.length} layers`);
      if (name === "mu_pa") mu[Number(item) - 1] = value * 1e-6;
      else if (name === "offset_throughout_mm" && !model.pathAngle) strength = value;
      else if (name === "cut_angle_throughout_deg" && model.pathAngle) strength = value * (Math.PI / 180);
      else if (!scene.shape_parameters.some((one) => one.name === name))
        throw new ModelError(`the tissue law has no ${name}`, "a parameter of the law");
    }
    const shape = this.shapeAfter(parameters);
    const same = JSON.stringify(shape) === JSON.stringify(model.shape);
    const law = same ? model.law : makeLaw(scene.simulation.law, shape);
    if (!law) throw new ModelError("the law has not been computed with these parameters", "the program");
    const steps = session.path().map(({ depth, inputs: { bevel, ...held } }) => (
      { depth, inputs: { ...held, bevel: { ...bevel, strength: strength ?? bevel.strength } } }));
    if (!this.#guard(() => session.again({ ...model, mu, law, shape }, steps))) {
      throw new ModelError(`with these parameters the insertion so far fails ${session.depth.toFixed(1)} mm deep`, BEARABLE);
    }
  }

  /** @param {Change[]} changes */
  #move(changes) {
    const { session } = this;
    const { x, u, planes } = session.shape;
    const { depth, inputs } = applyChanges(session, changes, this.names, [u[x.length - 1], planes > 1 ? u[u.length - 1] : 0], this.model);
    if (!changes.length) return;
    const shape = this.#guard(() => session.go(depth, inputs));
    if (session.failed) throw new ModelError(`the model finds no needle there (${shape.status})`, BEARABLE);
  }

  /** The kernel's refusals as those of the model. @template T @param {() => T} work */
  #guard(work) {
    try {
      return work();
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      throw new ModelError(error.message, `a needle of ${this.model.length} mm, its base before guides and tissue`);
    }
  }
}
