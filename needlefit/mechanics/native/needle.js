// A needle computed by kernel.wasm, for a page or Node.js. Needs only memory.js beside it.
// Lengths in mm, moduli in MPa, forces in N, slopes and friction without unit; axes as in docs/model.md. All
// equations are those of kernel.wasm, and so are the bytes of the results.
//
//     const kernel = await compile(bytes)
//     const session = await Session.begin(kernel, model, inputs)
//     const shape = session.go(5, inputs)
//
// Model, Inputs and Shape are types of page/types.d.ts. A needle is computed in two planes, y and z, from the first
// inputs on that lead it out of the plane z = 0.

import { STATUS, Heap, check, compile, makeProblem, makeShapes, rewrite } from "./memory.js";

export { compile };

const SAME_DEPTH = 1e-9; // mm
const MAX_ELEMENTS = 5000;
const MAX_GUIDES = 50;
const LINEAR_CUT = -1; // in place of `switch`
const MAX_RAYS = 15000; // MAX_STEPS + MAX_ELEMENTS of schemas/limits.py
const STOP_BYTES = 48; // of `struct Stop` in needle.hpp
const MOVE_BYTES = 24; // of `struct Move` and `struct CutRay` in plan.hpp
const POSITION_BYTES = 64; // of `struct Position` in plan.hpp

// inputs

/** Throw a RangeError for what is no needle or no inputs at a depth. @param {Model} model @param {Inputs} inputs @param {number} depth */
function checkInputs({ length, element }, { guides }, depth) {
  if (!(depth >= 0 && depth < length && depth <= MAX_ELEMENTS * element)) throw new RangeError(`the needle cannot be ${depth} mm deep`);
  if (guides.length > MAX_GUIDES) throw new RangeError(`${guides.length} guides; there may be ${MAX_GUIDES}`);
  const ends = [depth - length, ...guides.map(({ x }) => x)];
  if (ends.some((x, i) => i > 0 && !(x > ends[i - 1]))) throw new RangeError(`base and guides stand at ${ends} mm; they must increase`);
}

/** Toward where, y and z, a bevel turns the cut: `Bevel.toward` in Python. @param {Heap} heap @param {Inputs["bevel"]} bevel */
function findToward(heap, { side, roll }) {
  if (roll === 0) return [side, 0];
  const quarters = Math.floor(roll / 90 + 0.5);
  const rest = (roll - 90 * quarters) * (Math.PI / 180);
  const [z, y] = [3, 4].map((which) => side * heap.evaluate(which, rest));
  return [[y, z], [-z, y], [-y, -z], [z, -y]][((quarters % 4) + 4) % 4];
}

/** Whether inputs leave the needle in the plane z = 0. @param {Heap} heap @param {Inputs} inputs */
const isPlanar = (heap, { bevel, tip }) => findToward(heap, bevel)[1] === 0 && !tip?.z;

/** What holds the needle at a place, in each plane. @type {(y: number, slope: number | null, z: number, planes: number) => number[]} */
const listHeld = (y, slope, z, planes) => [y, slope ?? NaN, z, slope === null ? NaN : 0].slice(0, 2 * planes);

/** As many numbers for any guides, so that later ones have room; they stand at z = 0. @param {Guide[]} guides @param {number} planes */
function listGuides(guides, planes) {
  const listed = new Float64Array((1 + 2 * planes) * MAX_GUIDES);
  listed.set(guides.flatMap(({ x, y, slope }) => [x, ...listHeld(y, slope, 0, planes)]));
  return listed;
}

/** The arrays of a problem that hold the inputs. @param {Heap} heap @param {Inputs} inputs @param {Model} model @param {number} planes */
function packInputs(heap, { bevel, base, guides, tip }, model, planes) {
  const [before, within] = [guides.filter(({ x }) => x < 0), guides.filter(({ x }) => x >= 0)];
  const toward = findToward(heap, bevel).slice(0, planes);
  return {
    turn: Float64Array.from(toward, (part) => (part * bevel.strength) / (model.pathAngle ? 1 : model.spacing)),
    base: Float64Array.from([base.y, base.slope, base.stageSlope, 0, 0, 0].slice(0, 3 * planes)),
    before_first: BigInt64Array.of(0n, BigInt(before.length)),
    within_first: BigInt64Array.of(0n, BigInt(within.length)),
    before: listGuides(before, planes),
    within: listGuides(within, planes),
    held_tip: Float64Array.from(tip ? listHeld(tip.y, tip.slope, tip.z ?? 0, planes) : Array(2 * planes).fill(NaN)),
  };
}

/** A problem of one needle under `inputs`. @param {Heap} heap @param {Model} model @param {Inputs} inputs @param {number} planes @param {number} rays */
function pack(heap, model, inputs, planes, rays) {
  const { boundaries, rigidity, mu, thickness, friction, law } = model;
  const arrays = Object.entries({ boundaries, rigidity: [rigidity], mu, thickness, friction, law });
  return makeProblem(heap, {
    planes, rays, sets: 1, layers: mu.length, shapes: 1, terms: model.terms, numbers: law.length / mu.length,
    stop_count: 1, bevels: 1, inputs: 1, guides: MAX_GUIDES, columns: 0, max_iterations: model.maxIterations,
    length: model.length, first_cell: model.firstCell, spacing: model.spacing, element: model.element,
    part: model.pathAngle ? LINEAR_CUT : model.switch, tangent: model.tangent, tolerance: model.tolerance,
    deepest: findDeepest(model),
  }, {
    ...Object.fromEntries(arrays.map(([name, values]) => [name, Float64Array.from(values)])),
    stops: new Uint8Array(STOP_BYTES), ...packInputs(heap, inputs, model, planes),
  });
}

/** How deep a needle can be, mm. @param {Model} model */
const findDeepest = ({ length, element }) => Math.min(length, MAX_ELEMENTS * element);

/** The shape of a problem of one set. @param {Heap} heap @param {ReturnType<typeof makeShapes>} shapes @param {number} points @returns {Shape} */
function readShape(heap, { places, planes, room }, points) {
  const [status, nodes] = ["status", "nodes"].map((name) => Number(heap.integers(places[name], 1)[0]));
  /** @param {string} name @param {number} count */
  const read = (name, count, plane = 0) => heap.floats(places[name] + 8 * plane * room, count).slice();
  /** @param {string} name */
  const readPlanes = (name) => (planes === 1 ? read(name, nodes) : Float64Array.of(...read(name, nodes), ...read(name, nodes, 1)));
  const x = read("x", nodes);
  return {
    status: STATUS[status], depth: x[nodes - 1], planes, x, u: readPlanes("u"), slope: readPlanes("slope"),
    constraints: read("constraints", (1 + planes) * points), track: read("track", 2 * planes * points),
  };
}

/**
 * Memory from an address on for a problem and its state, which is that of first contact, or of `old`, which has fewer rays.
 *
 * @param {Heap} heap @param {number} base @param {Pick<Session, "model" | "inputs" | "planes" | "rays">} needle @param {{ problem: { at: number }, state: number, scratch: number }} [old]
 */
function layOut(heap, base, { model, inputs, planes, rays }, old) {
  const { call } = heap;
  heap.top = base;
  const problem = pack(heap, model, inputs, planes, rays);
  const [shapes, done] = [makeShapes(heap, problem, problem.maxPoints), heap.take(24)];
  call.nf_session_memory(problem.at, done);
  const [fixedBytes, bytes, scratchBytes] = heap.integers(done, 3).map(BigInt);
  const [fixed, state, next, scratch] = [fixedBytes, bytes, bytes, scratchBytes].map((size) => heap.take(size));
  call.nf_session_begin(problem.at, fixed, state, scratch);
  if (old) call.nf_session_copy(old.problem.at, problem.at, fixed, old.state, old.scratch, state, scratch);
  return { problem, shapes, done, fixed, state, next, scratch, bytes: Number(bytes), end: heap.top };
}

// one needle, step by step

/** A needle that is inserted from its present state: the same bytes as `mechanics.session.Session`. */
export class Session {
  /** Begin at first contact. Each session has a memory of its own, which is freed with it. @param {WebAssembly.Module} kernel @param {Model} model @param {Inputs} inputs */
  static async begin(kernel, model, inputs) {
    return new Session(await Heap.make(kernel), model, inputs);
  }

  failed = false;
  planes = 1;
  depth = 0;
  rays = 0; // for which there is room
  numbers = /** @type {Map<string, number>} */ (new Map()); // of bevels and controls: equal ones have equal numbers
  known = /** @type {any[]} */ ([]); // those by their numbers
  shape = /** @type {Shape} */ (/** @type {unknown} */ (null));
  memory = /** @type {ReturnType<typeof layOut>} */ (/** @type {unknown} */ (null));

  /** @param {Heap} heap @param {Model} model @param {Inputs} inputs */
  constructor(heap, model, inputs) {
    this.heap = heap;
    this.start = heap.top;
    this.model = model;
    this.inputs = inputs;
    this.#begin(model, inputs);
  }

  // In the plane, unless it was in space before, or the scene or the inputs lead out of it.
  /** @param {Model} model @param {Inputs} inputs */
  #begin(model, inputs, planes = model.spatial || !isPlanar(this.heap, inputs) ? 2 : this.planes) {
    this.#layOut({ model, inputs, planes, depth: 0, rays: Math.ceil(findDeepest(model) / model.spacing) });
    this.go(0, inputs);
  }

  /** Lay out memory for a state, which is that of first contact. @param {Partial<Session>} fields */
  #layOut(fields) {
    Object.assign(this, fields);
    this.memory = layOut(this.heap, this.start, this);
  }

  /**
   * Move the tip to a depth, mm, under all inputs; returns the shape.
   *
   * `failed` tells whether it has not converged: the needle has then stayed as it was.
   *
   * @param {number} depth @param {Inputs} given
   */
  go(depth, given) {
    const { heap, inputs: before } = this;
    const inputs = { ...given, guides: given.guides.toSorted((one, other) => one.x - other.x) };
    checkInputs(this.model, inputs, depth);
    if (this.planes === 1 && !isPlanar(heap, inputs)) {
      const path = this.path(); // again, in space
      this.#begin(this.model, path[0].inputs, 2);
      for (const one of path) this.go(one.depth, one.inputs);
    }
    this.inputs = inputs;
    rewrite(heap, this.memory.problem, packInputs(heap, inputs, this.model, this.planes));
    const numbers = this.#count(inputs);
    const advance = () => {
      const { problem, shapes, done, fixed, state, next, scratch } = this.memory;
      const fault = heap.call.nf_session_advance(problem.at, fixed, state, next, scratch, shapes.at, depth, ...numbers.map(BigInt), done);
      return [fault, ...heap.integers(done, 3)].map(Number);
    };
    let [fault, stops, points, rays] = advance();
    if (rays > MAX_RAYS) {
      this.inputs = before;
      throw new RangeError(`the needle has changed its direction of cutting ${rays} times`);
    }
    if (rays > this.rays) {
      this.rays = 2 * rays;
      this.memory = layOut(heap, this.memory.end, this, this.memory);
      [fault, stops, points, rays] = advance();
    }
    check(fault);
    const shape = stops ? readShape(heap, this.memory.shapes, points) : this.shape; // nothing is solved where the bevel alone was turned
    this.failed = shape.status !== STATUS[0];
    if (this.failed) {
      this.inputs = before;
      return shape;
    }
    const { state, next } = this.memory;
    Object.assign(this.memory, { state: next, next: state });
    Object.assign(this, { depth, shape });
    return shape;
  }

  /** The numbers of the bevel and of the controls of inputs. @param {Inputs} inputs */
  #count({ bevel, ...held }) {
    return [bevel, held].map((value) => {
      const key = JSON.stringify(value, (name, part) => (name === "name" ? null : part)); // that of a guide moves nothing
      if (!this.numbers.has(key)) this.numbers.set(key, this.known.push(value));
      return /** @type {number} */ (this.numbers.get(key));
    });
  }

  /** Inputs by the numbers of their bevel and controls. @param {number[]} numbers @returns {Inputs} */
  #recall([bevel, held]) {
    return { bevel: this.known[bevel - 1], ...this.known[held - 1] };
  }

  /** The rays that the tip has cut, and whether inputs have changed since it came to its depth. */
  #listRays() {
    const { heap, memory: { problem, fixed, state, scratch } } = this;
    return heap.borrow(() => {
      const [cut, position] = [MOVE_BYTES * this.rays, POSITION_BYTES].map((bytes) => heap.take(bytes));
      const count = Number(heap.call.nf_session_rays(problem.at, fixed, state, scratch, cut, position));
      const rays = Array.from({ length: count }, (_, n) => ({
        start: heap.floats(cut + MOVE_BYTES * n, 1)[0], numbers: Array.from(heap.integers(cut + MOVE_BYTES * n + 8, 2), Number),
      }));
      return { rays, changed: heap.integers(position + POSITION_BYTES - 8, 1)[0] !== 0n };
    });
  }

  /** The present state, to which `restore` returns; it holds also after the model was changed. */
  save() {
    const { model, inputs, planes, depth, shape, rays, heap, memory } = this;
    const state = new Uint8Array(heap.memory.buffer, memory.state, memory.bytes).slice();
    return { model, inputs, planes, depth, shape, rays, state };
  }

  /** @param {ReturnType<Session["save"]>} saved */
  restore({ state, ...saved }) {
    this.#layOut(saved);
    this.heap.put(state, this.memory.state);
  }

  /** The shortest steps that lead from first contact to here, as `Session.input_path` in Python. */
  path() {
    const { firstCell, spacing } = this.model;
    const { rays, changed } = this.#listRays();
    /** @param {number[]} one @param {number[]} other */
    const alike = (one, other) => one.every((number, i) => number === other[i]);
    /** @param {Reached} step */
    const flip = ({ depth, inputs }) => ({ depth, inputs: { ...inputs, bevel: { ...inputs.bevel, side: -inputs.bevel.side } } });
    /** @param {number} depth */
    const isPoint = (depth) => {
      const cell = depth <= SAME_DEPTH ? 0 : 1 + Math.max(0, Math.ceil((depth - firstCell - SAME_DEPTH) / spacing));
      return Math.abs((cell && firstCell + (cell - 1) * spacing) - depth) <= SAME_DEPTH;
    };
    const steps = /** @type {Reached[]} */ ([]);
    rays.forEach(({ start, numbers }, n) => {
      const again = n > 0 && alike(rays[n - 1].numbers, numbers);
      if (again && isPoint(start)) steps.pop(); // at a constraint point a new ray begins of itself
      else if (again) steps.push(flip(steps[steps.length - 1])); // within a cell only changed inputs begin one
      steps.push({ depth: rays[n + 1]?.start ?? this.depth, inputs: this.#recall(numbers) });
    });
    const last = { depth: this.depth, inputs: this.inputs };
    if (!rays.length || !alike(rays[rays.length - 1].numbers, this.#count(this.inputs))) steps.push(last);
    else if (changed) steps.push(flip(last), last);
    return steps;
  }

  /** Simulate steps from first contact on, with another model; returns whether each has converged. @param {Model} model @param {Reached[]} steps */
  again(model, steps) {
    this.#begin(model, steps[0].inputs);
    return steps.every(({ depth, inputs }) => {
      this.go(depth, inputs);
      return !this.failed;
    });
  }

  /** The points (K * (1 + planes)), mm, of the needle at beam coordinates `s` (K), mm: 0 at the entry, depth at the tip. @param {ArrayLike<number>} s */
  positions(s) {
    const { heap, shape: { x, u, slope, planes, depth } } = this;
    const at = Float64Array.from(s);
    if (!at.every((one) => one >= x[0] && one <= depth)) throw new RangeError("s lies beyond the needle");
    return heap.borrow(() => {
      const out = heap.take(8 * (1 + planes) * at.length);
      const memory = heap.take(8 * (1 + 5 * planes) * (x.length + 2) * Number(heap.call.nf_lanes()));
      const counts = [planes, 1, x.length, at.length].map(BigInt);
      heap.call.nf_positions(...counts, ...[x, u, slope, at].map((array) => heap.put(array)), memory, out);
      return heap.floats(out, (1 + planes) * at.length).slice();
    });
  }

  /** The lateral load of the tissue (planes * K), N/mm, at beam coordinates `s` (K), mm, as `compute_lateral_load` in Python. @param {ArrayLike<number>} s */
  load(s) {
    const { heap, memory: { problem }, shape: { planes, x, u, slope, constraints } } = this;
    return heap.borrow(() => {
      const cells = constraints.length / (1 + planes) - 1;
      const needle = heap.structure([x.length, cells], [], [x, u, slope, constraints].map((array) => heap.put(array)));
      const memory = heap.take(heap.call.nf_memory(problem.at, 1n));
      const out = heap.take(8 * planes * s.length);
      heap.call.nf_load(problem.at, needle, BigInt(s.length), heap.put(Float64Array.from(s)), memory, out);
      return heap.floats(out, planes * s.length).slice();
    });
  }
}
