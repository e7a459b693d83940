// What driver.cpp does, in WebAssembly: node driver.mjs memory.js kernel.wasm problems results
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [library, wasm, problems, results] = process.argv.slice(2);
const { ARRAYS, NUMBERS, SIZES, Heap, check, compile, makeProblem, makeShapes } = await import(
  pathToFileURL(library).href
);
const kernel = await compile(readFileSync(wasm)),
  file = readFileSync(problems),
  parts = [];
let at = 0;
const number = () => Number(file.readBigInt64LE((at += 8) - 8));
const bytes = (count) => file.subarray(at, (at += count)).slice();
const TYPES = {
  stops: Uint8Array,
  before_first: BigInt64Array,
  within_first: BigInt64Array,
  column_of: BigInt64Array,
  guide_columns: BigInt64Array,
};

while (at < file.length) {
  const points = number(),
    heap = await Heap.make(kernel),
    fields = {},
    arrays = {};
  for (const name of SIZES) fields[name] = number();
  for (const name of NUMBERS) fields[name] = file.readDoubleLE((at += 8) - 8);
  for (const name of ARRAYS) {
    const count = number(),
      Type = TYPES[name] ?? Float64Array;
    if (count >= 0) arrays[name] = new Type(Uint8Array.from(bytes(count)).buffer);
  }
  const s = Uint8Array.from(bytes(number()));
  const problem = makeProblem(heap, fields, arrays);
  problem.room = Number(heap.call.nf_nodes(problem.at, heap.take(8 * problem.room)));
  const shapes = makeShapes(heap, problem, points);
  new Uint8Array(heap.memory.buffer).fill(0, shapes.x, shapes.at);
  heap.borrow(() => {
    const lanes = heap.call.nf_lanes(),
      memory = heap.take(heap.call.nf_memory(problem.at, lanes));
    for (let first = 0n; first < fields.sets; first += lanes)
      check(heap.call.nf_simulate(problem.at, first, lanes, memory, shapes.at));
  });
  const write = (address, count) =>
    parts.push(Buffer.from(new Uint8Array(heap.memory.buffer, address, count).slice()));
  for (const [name, count] of Object.entries(shapes.counts)) write(shapes[name], 8 * count);
  const nodes = Number(heap.integers(shapes.nodes, 1)[0]),
    wanted = s.length / 8;
  const { planes, sets } = fields,
    coordinates = heap.put(s),
    out = heap.take((1 + planes) * s.length);
  const memory = heap.take(8 * (1 + 5 * planes) * (nodes + 2) * Number(heap.call.nf_lanes()));
  const gathered = ["u", "slope"].map(() => heap.take(8 * planes * nodes));
  for (let set = 0; set < sets; set++) {
    ["u", "slope"].forEach((name, i) => {
      for (let plane = 0; plane < planes; plane++) {
        const from = heap.floats(shapes[name] + 8 * (plane * sets + set) * problem.room, nodes);
        heap.floats(gathered[i] + 8 * plane * nodes, nodes).set(from);
      }
    });
    heap.call.nf_positions(
      BigInt(planes),
      1n,
      BigInt(nodes),
      BigInt(wanted),
      shapes.x + 8 * set * problem.room,
      ...gathered,
      coordinates,
      memory,
      out,
    );
    write(out, 8 * (1 + planes) * wanted);
  }
}
writeFileSync(results, Buffer.concat(parts));
