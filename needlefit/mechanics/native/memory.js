// The memory of kernel.wasm: problems and shapes as the kernel reads and writes them, as in native.py.

export const STATUS = ["converged", "over-compressed", "not converged", "non-finite"];
const FAULTS = ["", "size", "mesh", "stop", "guides", "column", "output", "points"]; // of native/checks.hpp

// As in `native.py`: sizes, numbers and arrays of a Problem in their order.
export const SIZES =
  "planes sets layers shapes terms numbers stop_count bevels inputs rays guides columns max_iterations".split(" ");
export const NUMBERS = "length first_cell spacing element part tangent tolerance deepest".split(" ");
export const ARRAYS = (
  "boundaries stops rigidity mu thickness friction law law_by turn base before_first within_first before " +
  "within held_tip guide_x turn_by column_of guide_columns"
).split(" ");

/** Compile the bytes of kernel.wasm; sessions take what this resolves to. */
export const compile = (bytes) => WebAssembly.compile(bytes);

/** An instance of the kernel, and its memory: it grows, and views of it are made anew each time. */
export class Heap {
  constructor(instance) {
    this.call = instance.exports;
    this.memory = instance.exports.memory;
    this.top = this.bottom = this.memory.buffer.byteLength; // below are the kernel's stack and constants
  }

  static async make(kernel) {
    return new Heap(await WebAssembly.instantiate(kernel, {}));
  }

  take(bytes) {
    const at = Math.ceil(this.top / 64) * 64;
    this.top = at + Number(bytes);
    const missing = this.top - this.memory.buffer.byteLength;
    if (missing > 0) this.memory.grow(Math.ceil(missing / 65536)); // a RangeError if there is no more
    return at;
  }

  put(array, at = this.take(array.byteLength)) {
    new Uint8Array(this.memory.buffer, at, array.byteLength).set(
      new Uint8Array(array.buffer, array.byteOffset, array.byteLength),
    );
    return at;
  }

  /** Call a function, and release what it took. */
  borrow(work) {
    const top = this.top;
    try {
      return work();
    } finally {
      this.top = top;
    }
  }

  /** An elementary function of the kernel, by its number in `nf_function`. */
  evaluate(which, x) {
    return this.borrow(() => {
      const [at, out] = [this.put(Float64Array.of(x)), this.take(8)];
      this.call.nf_function(BigInt(which), 1n, at, out);
      return this.floats(out, 1)[0];
    });
  }

  floats(at, count) {
    return new Float64Array(this.memory.buffer, at, count);
  }
  integers(at, count) {
    return new BigInt64Array(this.memory.buffer, at, count);
  }
  view(at) {
    return new DataView(this.memory.buffer, at);
  }

  // A structure of 64-bit numbers and 32-bit addresses.
  structure(integers, numbers, addresses) {
    const at = this.take(8 * (integers.length + numbers.length) + 4 * addresses.length),
      view = this.view(at);
    integers.forEach((value, i) => view.setBigInt64(8 * i, BigInt(value), true));
    numbers.forEach((value, i) => view.setFloat64(8 * (integers.length + i), value, true));
    addresses.forEach((value, i) =>
      view.setUint32(8 * (integers.length + numbers.length) + 4 * i, value, true),
    );
    return at;
  }
}

/** Throw a TypeError for a fault that the kernel has found. */
export function check(fault) {
  if (fault) throw new TypeError(`the kernel refuses a problem: ${FAULTS[Number(fault)]}`);
}

/** Write the structure of a problem whose arrays are at addresses. */
export const makeStructure = (heap, fields, addresses) =>
  heap.structure(
    SIZES.map((name) => fields[name]),
    NUMBERS.map((name) => fields[name]),
    addresses,
  );

/** Write a problem into the heap: `fields` of SIZES and NUMBERS, typed arrays by the names of ARRAYS. */
export function makeProblem(heap, fields, arrays) {
  const f = fields,
    n = f.sets * f.layers;
  const counts = {
    boundaries: f.sets * (f.layers - 1),
    rigidity: f.sets,
    mu: n,
    thickness: n,
    friction: n,
    law: n * f.numbers,
    turn: f.bevels * f.sets * f.planes,
    base: 3 * f.inputs * f.sets * f.planes,
    before_first: f.inputs + 1,
    within_first: f.inputs + 1,
    held_tip: 2 * f.inputs * f.planes,
    guide_x: f.sets,
  };
  for (const [name, count] of Object.entries(counts)) {
    if ((arrays[name] || name !== "guide_x") && arrays[name].length !== count)
      throw new TypeError(`${name} has ${arrays[name].length} numbers, not ${count}`);
  }
  const addresses = ARRAYS.map((name) => (arrays[name] ? heap.put(arrays[name]) : 0));
  const at = makeStructure(heap, f, addresses);
  const sizes = heap.take(24);
  check(heap.call.nf_check(at, sizes));
  const [room, points] = heap.integers(sizes, 2);
  return {
    at,
    sizes,
    fields: f,
    arrays: Object.fromEntries(ARRAYS.map((name, i) => [name, addresses[i]])),
    room: Number(room),
    maxPoints: Number(points),
  };
}

/** Write other arrays of the same sizes into a problem. */
export function rewrite(heap, problem, arrays) {
  for (const [name, array] of Object.entries(arrays)) heap.put(array, problem.arrays[name]);
  check(heap.call.nf_check(problem.at, problem.sizes));
}

/** Take room for the shapes of all sets; addresses by name, and the `counts` of 64-bit numbers there. */
export function makeShapes(heap, problem, points) {
  const { sets, columns, planes } = problem.fields,
    { room } = problem;
  const counts = {
    x: sets * room,
    u: planes * sets * room,
    slope: planes * sets * room,
    constraints: (1 + planes) * sets * points,
    track: 2 * planes * sets * points,
    status: sets,
    passes: sets,
    nodes: 1,
    u_by: planes * sets * room * columns,
    slope_by: planes * sets * room * columns,
    constraints_by: planes * sets * points * columns,
    track_by: planes * sets * points * columns,
  };
  const shapes = { points, counts, room, planes };
  for (const [name, count] of Object.entries(counts))
    shapes[name] = columns || !name.endsWith("_by") ? heap.take(8 * count) : 0;
  shapes.at = heap.structure(
    [room, points],
    [],
    Object.keys(counts).map((name) => shapes[name]),
  );
  return shapes;
}

/** Return u or slope (planes * nodes) of a problem of one set, the planes one after the other. */
export function readPlanes(heap, shapes, name, planes, nodes) {
  const read = new Float64Array(planes * nodes);
  for (let plane = 0; plane < planes; plane += 1)
    read.set(heap.floats(shapes[name] + 8 * plane * shapes.room, nodes), plane * nodes);
  return read;
}

/** Return the shape of a problem of one set. */
export function readShape(heap, shapes, points) {
  const { planes } = shapes;
  const number = (name) => Number(heap.integers(shapes[name], 1)[0]);
  const read = (name, count) => heap.floats(shapes[name], count).slice();
  const nodes = number("nodes"),
    x = read("x", nodes);
  return {
    status: STATUS[number("status")],
    passes: number("passes"),
    depth: x.at(-1),
    planes,
    x,
    u: readPlanes(heap, shapes, "u", planes, nodes),
    slope: readPlanes(heap, shapes, "slope", planes, nodes),
    constraints: read("constraints", (1 + planes) * points),
    track: read("track", 2 * planes * points),
  };
}
