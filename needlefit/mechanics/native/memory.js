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

/** Compile the bytes of kernel.wasm; sessions take what this resolves to. @param {BufferSource} bytes */
export const compile = (bytes) => WebAssembly.compile(bytes);

/** An instance of the kernel, and its memory: it grows, and views of it are made anew each time. */
export class Heap {
  /** @param {WebAssembly.Instance} instance */
  constructor(instance) {
    this.call = /** @type {Record<string, (...given: any[]) => any>} */ (instance.exports);
    this.memory = /** @type {WebAssembly.Memory} */ (instance.exports.memory);
    this.top = this.memory.buffer.byteLength; // below are the kernel's stack and constants
  }

  /** @param {WebAssembly.Module} kernel */
  static async make(kernel) {
    return new Heap(await WebAssembly.instantiate(kernel, {}));
  }

  /** @param {number | bigint} bytes */
  take(bytes) {
    const at = Math.ceil(this.top / 64) * 64;
    this.top = at + Number(bytes);
    const missing = this.top - this.memory.buffer.byteLength;
    if (missing > 0) this.memory.grow(Math.ceil(missing / 65536)); // a RangeError if there is no more
    return at;
  }

  /** @param {Numbers} array */
  put(array, at = this.take(array.byteLength)) {
    new Uint8Array(this.memory.buffer, at).set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
    return at;
  }

  /** Call a function, and release what it took. @template T @param {() => T} work */
  borrow(work) {
    const { top } = this;
    try {
      return work();
    } finally {
      this.top = top;
    }
  }

  /** An elementary function of the kernel, by its number in `nf_function`. @param {number} which @param {number} x */
  evaluate(which, x) {
    return this.borrow(() => {
      const [at, out] = [this.put(Float64Array.of(x)), this.take(8)];
      this.call.nf_function(BigInt(which), 1n, at, out);
      return this.floats(out, 1)[0];
    });
  }

  /** @param {number} at @param {number} count */
  floats(at, count) {
    return new Float64Array(this.memory.buffer, at, count);
  }
  /** @param {number} at @param {number} count */
  integers(at, count) {
    return new BigInt64Array(this.memory.buffer, at, count);
  }

  /** Write a structure of 64-bit numbers and 32-bit addresses. @param {(number | bigint)[]} integers @param {number[]} numbers @param {number[]} addresses */
  structure(integers, numbers, addresses) {
    const at = this.take(8 * (integers.length + numbers.length) + 4 * addresses.length);
    this.put(BigInt64Array.from(integers, BigInt), at);
    this.put(Float64Array.from(numbers), at + 8 * integers.length);
    this.put(Uint32Array.from(addresses), at + 8 * (integers.length + numbers.length));
    return at;
  }
}

/** Throw a TypeError for a fault that the kernel has found. @param {number | bigint} fault */
export function check(fault) {
  if (fault) throw new TypeError(`the kernel refuses a problem: ${FAULTS[Number(fault)]}`);
}

/** Write a problem into the heap: `fields` of SIZES and NUMBERS, typed arrays by the names of ARRAYS. @param {Heap} heap @param {Record<string, number | bigint>} fields @param {Record<string, Numbers>} arrays */
export function makeProblem(heap, fields, arrays) {
  const addresses = ARRAYS.map((name) => (arrays[name] ? heap.put(arrays[name]) : 0));
  const at = heap.structure(SIZES.map((name) => fields[name]), NUMBERS.map((name) => Number(fields[name])), addresses);
  const sizes = heap.take(24);
  check(heap.call.nf_check(at, sizes));
  const [room, maxPoints] = heap.integers(sizes, 2);
  const places = Object.fromEntries(ARRAYS.map((name, i) => [name, addresses[i]]));
  return { at, sizes, fields, arrays: places, room: Number(room), maxPoints: Number(maxPoints) };
}

/** @typedef {ReturnType<typeof makeProblem>} Problem */

/** Write other arrays of the same sizes into a problem. @param {Heap} heap @param {Problem} problem @param {Record<string, Numbers>} arrays */
export function rewrite(heap, problem, arrays) {
  for (const [name, array] of Object.entries(arrays)) heap.put(array, problem.arrays[name]);
  check(heap.call.nf_check(problem.at, problem.sizes));
}

/** Take room for the shapes of all sets; addresses by name, and the `counts` of 64-bit numbers there. @param {Heap} heap @param {Problem} problem @param {number} points */
export function makeShapes(heap, { fields, room }, points) {
  const [sets, columns, planes] = ["sets", "columns", "planes"].map((name) => Number(fields[name]));
  const values = {
    x: sets * room, u: planes * sets * room, slope: planes * sets * room,
    constraints: (1 + planes) * sets * points, track: 2 * planes * sets * points,
  };
  const derivatives = { u_by: values.u, slope_by: values.slope, constraints_by: planes * sets * points, track_by: planes * sets * points };
  const counts = Object.fromEntries([
    ...Object.entries({ ...values, status: sets, passes: sets, nodes: 1 }),
    ...Object.entries(derivatives).map(([name, count]) => [name, count * columns]),
  ]);
  const places = Object.fromEntries(Object.entries(counts).map(([name, count]) => [name, count ? heap.take(8 * count) : 0]));
  return { ...places, places, counts, room, planes, at: heap.structure([room, points], [], Object.values(places)) };
}
