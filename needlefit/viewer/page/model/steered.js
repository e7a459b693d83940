/** The needle of a scene, simulated step by step: the same changes find the same bits as `SteeredNeedle` in Python. */

import { Session } from "../../../mechanics/native/needle.js";
import { applyChanges, checkChange, ModelError, toInputs, toStep } from "./inputs.js";

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
    return new SteeredNeedle(scene, await Session.begin(kernel, model, toInputs(steps[0], model.pathAngle)));
  }

  way = /** @type {Way | null} */ (null); // the newest of the changes that led here
  number = 0;
  saved = /** @type {Map<number, any>} */ (new Map());

  /** @param {Scene} scene @param {Session} session */
  constructor(scene, session) {
    const { shape, steps, rules } = scene.simulation;
    this.scene = scene;
    this.session = session;
    this.rules = rules;
    this.shape = shape;
    this.names = scene.guide_names;
    this.step = { ...steps[0], depth: 0 };
    this.keep();
  }

  get model() {
    return this.session.model;
  }

  /** The greatest depth that is possible under controls, mm: the base is then just before guides or tissue. */
  reach(controls = this.step.controls) {
    const [first] = controls.guides;
    return this.model.length + (first && first.x < 0 ? first.x - this.rules.clearance_mm : 0) - 1e-6;
  }

  /** The place of the tip, y in mm, as a recording has it. */
  get tipLateral() {
    return this.session.positions([this.session.shape.depth])[1];
  }

  /** The shortest steps that lead to the present state. */
  path() {
    return this.session.path().map((reached) => toStep(reached, this.model.pathAngle));
  }

  /** All changes that led here from first contact, without those that were undone by a return. */
  listWay() {
    const ways = [];
    for (let way = this.way; way; way = way.before) ways.push(way);
    return ways.reverse();
  }

  keep() {
    const { step, shape, way } = this;
    if (!this.saved.has(this.number)) this.saved.set(this.number, { step, shape, way, session: this.session.save() });
  }

  /** Delete the state stored at a step; the initial state stays. @param {number} number */
  forget(number) {
    if (number) this.saved.delete(number);
  }

  /** Return to first contact, as if nothing had been carried out. */
  rewind() {
    const [[, first]] = this.saved;
    this.#return(first);
    Object.assign(this, { number: 0, saved: new Map([[0, first]]) });
  }

  /** @param {any} stored */
  #return({ session, ...saved }) {
    this.session.restore(session);
    Object.assign(this, saved);
  }

  /** The shape parameters after changes. @param {Change[]} changes */
  shapeAfter(changes) {
    const shape = this.shape.map((row) => [...row]);
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
    const { step, shape } = this;
    const before = { step, shape, session: this.session.save() };
    try {
      this.#simulateAgain(parameters);
      this.#move(others);
    } catch (error) {
      this.#return(before);
      throw error;
    }
  }

  /** @param {Change[]} parameters */
  #simulateAgain(parameters) {
    const mu = [...this.model.mu];
    let [offset, angle] = /** @type {(number | null)[]} */ ([null, null]);
    for (const [name, item, value] of parameters) {
      if (item && item > mu.length) throw new ModelError(`there is no layer ${item}`, `one of ${mu.length} layers`);
      if (name === "mu_pa") mu[Number(item) - 1] = value * 1e-6;
      else if (name === "offset_throughout_mm") offset = value;
      else if (name === "cut_angle_throughout_deg") angle = value * (Math.PI / 180);
      else if (!this.scene.shape_parameters.some((one) => one.name === name))
        throw new ModelError(`the tissue law has no ${name}`, "a parameter of the law");
    }
    const shape = this.shapeAfter(parameters);
    const same = JSON.stringify(shape) === JSON.stringify(this.shape);
    const law = same ? this.model.law : makeLaw(this.scene.simulation.law, shape);
    if (!law) throw new ModelError("the law has not been computed with these parameters", "the program");
    const { pathAngle } = this.model;
    const steps = this.path().map(({ bevel, ...one }) => ({
      ...one, bevel: { ...bevel, offset: offset ?? bevel.offset, cutAngle: angle ?? bevel.cutAngle },
    }));
    const converged = this.#guard(() => this.session.again(
      { ...this.model, mu, law }, steps.map((one) => ({ depth: one.depth, inputs: toInputs(one, pathAngle) })),
    ));
    if (!converged) {
      throw new ModelError(`with these parameters the insertion so far fails ${this.session.depth.toFixed(1)} mm deep`, BEARABLE);
    }
    Object.assign(this, { shape, step: steps[steps.length - 1] });
  }

  /** @param {Change[]} changes */
  #move(changes) {
    const { session } = this;
    const { x, u, planes } = session.shape;
    const step = applyChanges(this.step, changes, this.names, [u[x.length - 1], planes > 1 ? u[u.length - 1] : 0]);
    if (!changes.length) return;
    const shape = this.#guard(() => session.go(step.depth, toInputs(step, this.model.pathAngle)));
    if (session.failed) {
      throw new ModelError(`the model finds no needle there (${shape.status})`, BEARABLE);
    }
    this.step = step;
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
