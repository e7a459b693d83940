// A needle computed by kernel.wasm, for a page or Node.js. Needs only memory.js beside it.
// Lengths in mm, moduli in MPa, forces in N, slopes and friction without unit; axes as in docs/model.md. All
// equations are those of kernel.wasm, and so are the bytes of the results.
//
//     const kernel = await compile(bytes)
//     const session = await Session.begin(kernel, model, inputs)
//     const shape = session.go(5, {bevel: {side: -1, strength: 0.1}})
//
// model: {length, rigidity,                          the needle: mm, EI in N mm^2
//         boundaries, mu, thickness, friction,       the layers: (n - 1), and (n) each
//         law, terms,                                (n * numbers) as `pack_layers` in Python returns it
//         spacing, element, firstCell,               the mesh
//         switch, pathAngle, tangent,                the rule of advance; by default 0.5, false, 1
//         tolerance, maxIterations}                  by default 1e-7 mm, 40
// inputs: {bevel: {side, roll, strength},            side +1 or -1, roll from there, degrees; b in mm, or with
//                                                    pathAngle theta in rad
//          base: {y, slope, stageSlope},
//          guides: [{x, y, slope}],                  slope null: turns freely; x >= 0: in the tissue
//          tip: null or {y, slope, z}}               tracked; slope null: free
// shape: {status, passes, depth, planes, x,          Float64Arrays of the nodes, base first: x (N), of each plane
//         u, slope,                                  (planes * N) deflection and slope
//         constraints, track}                        (m + 1, 1 + planes): depth and place of the cut;
//                                                    (m + 1, 2 planes): deflection and slope of the tip there
// A needle is computed in two planes, y and z, from the first inputs on that lead it out of the plane z = 0.

import {
  STATUS,
  Heap,
  check,
  compile,
  makeProblem,
  makeShapes,
  readShape,
  rewrite,
} from "./memory.js";

export { STATUS, compile };

const SAME_DEPTH = 1e-9; // mm
const MAX_ELEMENTS = 5000;
const MAX_GUIDES = 50;
const LINEAR_CUT = -1; // in place of `switch`
const MAX_RAYS = 15000; // MAX_STEPS + MAX_ELEMENTS of schemas/limits.py
const KEPT_IDS = 256; // of inputs before unused ones are dropped
const STOP_BYTES = 48; // of `struct Stop` in needle.hpp
const MOVE_BYTES = 24; // of `struct Move` and `struct CutRay` in plan.hpp
const POSITION_BYTES = 64; // of `struct Position` in plan.hpp

/** How deep a needle can be, mm. */
const findDeepest = (model) => Math.min(model.length, MAX_ELEMENTS * model.element);

// inputs

function completeInputs(inputs) {
  const { bevel = {}, base = {}, guides = [], tip = null } = inputs;
  return {
    bevel: { side: 1, roll: 0, strength: 0, ...bevel },
    base: { y: 0, slope: 0, stageSlope: 0, ...base },
    guides: guides.map((guide) => ({ y: 0, slope: 0, ...guide })).sort((a, b) => a.x - b.x),
    tip,
  };
}

/** Throw a RangeError for what is no needle, no tissue or no inputs at a depth. */
function checkInputs(model, inputs, depth) {
  const { guides } = inputs,
    base = depth - model.length,
    ends = [base, ...guides.map((guide) => guide.x)];
  for (const name of ["mu", "thickness"])
    if (!model[name].every((value) => value > 0)) throw new RangeError(`${name} is not above 0`);
  if (!(model.rigidity > 0 && base < 0)) throw new RangeError("the needle is too short, or its rigidity not above 0");
  if (guides.length > MAX_GUIDES) throw new RangeError(`${guides.length} guides; there may be ${MAX_GUIDES}`);
  if (ends.some((x, i) => i > 0 && !(x > ends[i - 1])))
    throw new RangeError(`base and guides stand at ${ends} mm; they must increase`);
}

/** Toward where, y and z, a bevel turns the cut: `Bevel.toward` in Python. */
function findToward(heap, { side, roll }) {
  if (roll === 0) return [side, 0];
  const quarters = Math.floor(roll / 90 + 0.5),
    rest = (roll - 90 * quarters) * (Math.PI / 180);
  const [z, y] = [3, 4].map((which) => side * heap.evaluate(which, rest));
  return [[y, z], [-z, y], [-y, -z], [z, -y]][((quarters % 4) + 4) % 4]; // prettier-ignore
}

/** Whether inputs leave the needle in the plane z = 0. */
const isPlanar = (heap, { bevel, tip }) => findToward(heap, bevel)[1] === 0 && !tip?.z;

/** As many numbers for any guides, so that later ones have room; they stand at z = 0. */
function listGuides(guides, planes) {
  const listed = new Float64Array((1 + 2 * planes) * MAX_GUIDES);
  guides.forEach(({ x, y, slope }, i) => listed.set([x, ...listHeld(y, slope, 0, planes)], i * (1 + 2 * planes)));
  return listed;
}
const listHeld = (y, slope, z, planes) => [y, slope ?? NaN, z, (slope ?? null) === null ? NaN : 0].slice(0, 2 * planes);
const listTip = (tip, planes) => (tip ? listHeld(tip.y, tip.slope, tip.z ?? 0, planes) : Array(2 * planes).fill(NaN));
const listBase = (base) => [base.y, base.slope, base.stageSlope];
const bevelKey = ({ bevel }) => JSON.stringify([bevel.side, bevel.roll, bevel.strength]);
const controlsKey = ({ base, guides, tip }) =>
  JSON.stringify([listBase(base), guides.map((guide) => [guide.x, guide.y, guide.slope ?? null]), listTip(tip, 2)]);

/** The arrays of a problem that hold the inputs. */
function packInputs(heap, { bevel, base, guides, tip }, model, planes) {
  const before = guides.filter((guide) => guide.x < 0),
    within = guides.filter((guide) => guide.x >= 0),
    toward = findToward(heap, bevel).slice(0, planes);
  return {
    turn: Float64Array.from(toward, (part) => (part * bevel.strength) / (model.pathAngle ? 1 : model.spacing)),
    base: Float64Array.from([...listBase(base), 0, 0, 0].slice(0, 3 * planes)),
    before_first: BigInt64Array.of(0n, BigInt(before.length)),
    within_first: BigInt64Array.of(0n, BigInt(within.length)),
    before: listGuides(before, planes),
    within: listGuides(within, planes),
    held_tip: Float64Array.from(listTip(tip, planes)),
  };
}

/** The fields and arrays of a problem under `inputs`. */
function pack(heap, model, inputs, planes, rays, deepest) {
  const layers = model.mu.length;
  const arrays = {
    boundaries: Float64Array.from(model.boundaries),
    stops: new Uint8Array(STOP_BYTES),
    rigidity: Float64Array.of(model.rigidity),
    ...Object.fromEntries(["mu", "thickness", "friction", "law"].map((name) => [name, Float64Array.from(model[name])])),
    ...packInputs(heap, inputs, model, planes),
  };
  const fields = {
    planes,
    sets: 1,
    layers,
    shapes: 1,
    terms: model.terms,
    numbers: model.law.length / layers,
    stop_count: 1,
    bevels: 1,
    inputs: 1,
    rays,
    guides: MAX_GUIDES,
    columns: 0,
    max_iterations: model.maxIterations ?? 40,
    length: model.length,
    first_cell: model.firstCell,
    spacing: model.spacing,
    element: model.element,
    part: model.pathAngle ? LINEAR_CUT : (model.switch ?? 0.5),
    tangent: model.tangent ?? 1,
    tolerance: model.tolerance ?? 1e-7,
    deepest,
  };
  return [fields, arrays];
}

// one needle, step by step

/** A needle that is inserted from its present state: the same bytes as `mechanics.session.Session`. */
export class Session {
  /** Begin at first contact. Each session has a memory of its own, which is freed with it. */
  static async begin(kernel, model, inputs = {}) {
    return new Session(await Heap.make(kernel), model, completeInputs(inputs));
  }

  heap; start; base; end; model; planes; depth; rays; ids; maxIds; solved; parts; stateBytes;
  /** @type {any} */
  problem;
  /** @type {any} */
  shapes;
  deepest = 0;

  constructor(heap, model, inputs) {
    Object.assign(this, { heap, start: heap.top, failed: false });
    this.#begin(model, inputs);
  }

  // In the plane, unless it was in space before, or the scene or the inputs lead out of it.
  #begin(model, inputs, planes = model.spatial || !isPlanar(this.heap, inputs) ? 2 : (this.planes ?? 1)) {
    this.deepest = findDeepest(model);
    const rays = Math.ceil(this.deepest / model.spacing);
    this.#layOut({ model, inputs, planes, depth: 0, ids: new Map(), maxIds: KEPT_IDS, solved: 0, shape: null, rays });
    this.shape = this.go(0, inputs);
  }

  // Lay out memory for a state, which is that of first contact.
  #layOut(fields) {
    Object.assign(this, fields, { base: this.start });
    this.#reserve();
  }

  // Take memory for problem and state; the state becomes that of `old`, which has fewer rays.
  #reserve(old) {
    const { heap, model, inputs, planes, rays, deepest } = this,
      { call } = heap;
    heap.top = this.base;
    const problem = makeProblem(heap, ...pack(heap, model, inputs, planes, rays, deepest));
    this.problem = problem;
    this.shapes = makeShapes(heap, problem, problem.maxPoints);
    this.done = heap.take(24);
    call.nf_session_memory(problem.at, this.done);
    const [fixed, state, scratch] = heap.integers(this.done, 3).map(BigInt);
    const parts = {
      fixed: heap.take(fixed),
      now: heap.take(state),
      next: heap.take(state),
      scratch: heap.take(scratch),
    };
    Object.assign(this, { parts, stateBytes: Number(state), end: heap.top });
    call.nf_session_begin(problem.at, parts.fixed, parts.now, parts.scratch);
    if (old) {
      const { now, scratch: room } = old.parts;
      call.nf_session_copy(old.problem.at, problem.at, parts.fixed, now, room, parts.now, parts.scratch);
    }
  }

  /**
   * Move the tip to a depth, mm, under all inputs; returns the shape.
   *
   * `failed` tells whether it has not converged: the needle has then stayed as it was.
   */
  go(depth, given) {
    if (!(depth >= 0 && depth <= this.deepest)) throw new RangeError(`the needle cannot be ${depth} mm deep`);
    const inputs = completeInputs(given),
      { heap } = this;
    checkInputs(this.model, inputs, depth);
    if (this.planes === 1 && !isPlanar(heap, inputs)) {
      const path = this.path(); // again, in space
      this.#begin(this.model, path[0].inputs, 2);
      for (const one of path) this.go(one.depth, one.inputs);
    }
    const before = this.inputs;
    this.inputs = inputs;
    rewrite(heap, this.problem, packInputs(heap, inputs, this.model, this.planes));
    const bevel = this.#number(bevelKey(inputs), inputs.bevel),
      held = this.#number(controlsKey(inputs), inputs);
    const advance = () => {
      const { fixed, now, next, scratch } = this.parts,
        { at } = this.problem;
      const fault = heap.call.nf_session_advance(
        at, fixed, now, next, scratch, this.shapes.at, depth, BigInt(bevel), BigInt(held), this.done,
      ); // prettier-ignore
      return [fault, ...heap.integers(this.done, 3)].map(Number);
    };
    let [fault, stops, points, rays] = advance();
    if (rays > MAX_RAYS) {
      this.inputs = before;
      throw new RangeError(`the needle has changed its direction of cutting ${rays} times`);
    }
    if (rays > this.rays) {
      const old = { problem: this.problem, parts: this.parts };
      Object.assign(this, { rays: 2 * rays, base: this.end });
      this.#reserve(old);
      [fault, stops, points, rays] = advance();
    }
    check(fault);
    this.solved += stops;
    let { shape } = this;
    if (stops > 0) {
      shape = readShape(heap, this.shapes, points);
      this.failed = shape.status !== STATUS[0];
      if (this.failed) {
        this.inputs = before;
        return shape;
      }
    }
    this.failed = false;
    [this.parts.now, this.parts.next] = [this.parts.next, this.parts.now];
    Object.assign(this, { depth, shape });
    if (this.ids.size > this.maxIds) this.#dropUnused(new Set([bevel, held]));
    return shape;
  }

  // Equal inputs have equal numbers.
  #number(key, value) {
    let found = this.ids.get(key);
    if (!found) {
      this.nextId = (this.nextId ?? 0) + 1;
      this.ids.set(key, (found = { number: this.nextId, value }));
    }
    return found.number;
  }

  #dropUnused(used) {
    for (const { bevel, held } of this.#listRays().rays) used.add(bevel).add(held);
    for (const [key, { number }] of this.ids) if (!used.has(number)) this.ids.delete(key);
    this.maxIds = KEPT_IDS + 2 * this.ids.size;
  }

  // The rays that the tip has cut, and whether inputs have changed since it came to its depth.
  #listRays() {
    const { heap, parts, problem } = this;
    return heap.borrow(() => {
      const cut = heap.take(MOVE_BYTES * this.rays),
        position = heap.take(POSITION_BYTES);
      const count = Number(heap.call.nf_session_rays(problem.at, parts.fixed, parts.now, parts.scratch, cut, position));
      const view = heap.view(cut),
        id = (at) => Number(view.getBigInt64(at, true));
      const rays = Array.from({ length: count }, (_, n) => ({
        start: view.getFloat64(MOVE_BYTES * n, true),
        bevel: id(MOVE_BYTES * n + 8),
        held: id(MOVE_BYTES * n + 16),
      }));
      return { rays, changed: heap.view(position).getBigInt64(POSITION_BYTES - 8, true) !== 0n };
    });
  }

  /** The present state, to which `restore` returns; it holds also after the model was changed. */
  save() {
    const { model, inputs, planes, depth, shape, rays, ids, maxIds, solved, heap, parts, stateBytes } = this;
    const state = new Uint8Array(heap.memory.buffer, parts.now, stateBytes).slice();
    return { model, inputs, planes, depth, shape, rays, ids: new Map(ids), maxIds, solved, state };
  }

  restore({ state, ...saved }) {
    this.#layOut({ ...saved, ids: new Map(saved.ids) });
    new Uint8Array(this.heap.memory.buffer).set(state, this.parts.now);
  }

  /** The shortest steps [{depth, inputs}] that lead from first contact to here, as `Session.input_path` in Python. */
  path() {
    const { firstCell, spacing } = this.model,
      { rays, changed } = this.#listRays(),
      values = new Map([...this.ids.values()].map(({ number, value }) => [number, value]));
    const alike = (one, other) => one.bevel === other.bevel && one.held === other.held;
    const flip = ({ depth, inputs }) => ({
      depth,
      inputs: { ...inputs, bevel: { ...inputs.bevel, side: -inputs.bevel.side } },
    });
    const isPoint = (depth) => {
      const cell =
        depth <= SAME_DEPTH ? 0 : 1 + Math.max(0, Math.ceil((depth - firstCell - SAME_DEPTH) / spacing));
      return Math.abs((cell && firstCell + (cell - 1) * spacing) - depth) <= SAME_DEPTH;
    };
    const steps = [];
    rays.forEach(({ start, bevel, held }, n) => {
      const depth = n + 1 < rays.length ? rays[n + 1].start : this.depth,
        step = { depth, inputs: { ...values.get(held), bevel: values.get(bevel) } },
        again = n > 0 && alike(rays[n - 1], rays[n]);
      if (again && isPoint(start)) steps.pop(); // at a constraint point a new ray begins of itself
      else if (again) steps.push(flip(steps.at(-1))); // within a cell only changed inputs begin one
      steps.push(step);
    });
    const last = { depth: this.depth, inputs: this.inputs },
      now = { bevel: this.#number(bevelKey(this.inputs)), held: this.#number(controlsKey(this.inputs)) };
    if (!rays.length || !alike(rays.at(-1), now)) steps.push(last);
    else if (changed) steps.push(flip(last), last);
    return steps;
  }

  /** Simulate steps from first contact on, with another model; returns whether each has converged. */
  again(model, steps) {
    this.#begin(model, completeInputs(steps[0].inputs));
    for (const { depth, inputs } of steps) {
      this.go(depth, inputs);
      if (this.failed) return false;
    }
    return true;
  }

  /** The points (K * (1 + planes)), mm, of the needle at beam coordinates `s` (K), mm: 0 at the entry, depth at the tip. */
  positions(s) {
    const { heap, shape } = this,
      { planes } = shape,
      at = Float64Array.from(s);
    if (!at.every((one) => one >= shape.x[0] && one <= shape.depth)) throw new RangeError("s lies beyond the needle");
    return heap.borrow(() => {
      const nodes = shape.x.length,
        size = (1 + planes) * at.length,
        out = heap.take(8 * size),
        memory = heap.take(8 * (1 + 5 * planes) * (nodes + 2) * Number(heap.call.nf_lanes())),
        counts = [planes, 1, nodes, at.length].map(BigInt),
        addresses = [shape.x, shape.u, shape.slope, at].map((array) => heap.put(array));
      heap.call.nf_positions(...counts, ...addresses, memory, out);
      return heap.floats(out, size).slice();
    });
  }

  /** The lateral load of the tissue (planes * K), N/mm, at beam coordinates `s` (K), mm, as `compute_lateral_load` in Python. */
  load(s) {
    const { heap, shape, problem } = this,
      { planes, x, u, slope, constraints } = shape;
    return heap.borrow(() => {
      const cells = constraints.length / (1 + planes) - 1,
        needle = heap.structure([x.length, cells], [], [x, u, slope, constraints].map((array) => heap.put(array))),
        memory = heap.take(heap.call.nf_memory(problem.at, 1n)),
        out = heap.take(8 * planes * s.length);
      heap.call.nf_load(problem.at, needle, BigInt(s.length), heap.put(Float64Array.from(s)), memory, out);
      return heap.floats(out, planes * s.length).slice();
    });
  }
}
