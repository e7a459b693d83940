// A needle computed by kernel.wasm, for a page or Node.js: an ES module without dependencies, and without access to files or
// the network. Lengths in mm, moduli in MPa, forces in N, slopes and friction without unit; y is positive to the left
// of the insertion as in docs/model.md. All equations are those of kernel.wasm, and so are the bytes of the results.
//
//     const kernel = await compile(bytes)
//     const session = await Session.begin(kernel, model, inputs)
//     session.set({bevel: {side: -1, strength: 0.1}})
//     const shape = session.advance(5)
//
// model: {length, rigidity,                          the needle: mm, EI in N mm^2
//         boundaries, mu, thickness, friction,       the layers: (n - 1), and (n) each
//         law, terms,                                (n * numbers), see native/law.hpp; packed by `pack_layers` in Python
//         spacing, element, firstCell,               the mesh
//         switch, pathAngle, tangent,                the rule of advance; by default 0.5, false, 1
//         tolerance, maxIterations}                  by default 1e-7 mm, 40
// inputs: {bevel: {side, strength},                  side +1 or -1; b in mm, or with pathAngle theta in rad
//          base: {y, slope, stageSlope},
//          guides: [{x, y, slope}],                  slope null: turns freely; x >= 0: in the tissue
//          tip: null or {y, slope}}                  tracked; slope null: free
// shape: {status, passes, depth, x, u, slope,        Float64Array of the nodes, base first
//         constraints, track}                        (m + 1) y of the cut, and (m + 1, 2) of the tip on its way

export const STATUS = ['converged', 'over-compressed', 'not converged', 'non-finite']

const SAME_DEPTH = 1e-9
const MAX_ELEMENTS = 5000
const MAX_GUIDES = 50
const LINEAR_CUT = -1
const PERMANENT = 1, STARTS_RAY = 2, EXTRAPOLATES = 4

const FAULTS = ['', 'size', 'mesh', 'stop', 'guides', 'column', 'output', 'points'] // of native/checks.hpp

// As in `native.py`: sizes, numbers and arrays of a Problem in their order.
export const SIZES = ['sets', 'layers', 'shapes', 'terms', 'numbers', 'stop_count', 'bevels', 'inputs', 'rays', 'guides',
  'columns', 'max_iterations']
export const NUMBERS = ['length', 'first_cell', 'spacing', 'element', 'part', 'tangent', 'tolerance', 'deepest']
export const ARRAYS = ['boundaries', 'stops', 'rigidity', 'mu', 'thickness', 'friction', 'law', 'law_by', 'turn', 'base',
  'before_first', 'within_first', 'before', 'within', 'held_tip', 'guide_x', 'turn_by', 'column_of', 'guide_columns']
const STOP_BYTES = 48

/** Compile the bytes of kernel.wasm; `Session.begin` and `simulateBatch` take what this resolves to. */
export const compile = bytes => WebAssembly.compile(bytes)

// ---- memory ----------------------------------------------------------------------------------------------------------

/** An instance of the kernel, and its memory: it grows, and views of it are made anew each time. */
export class Heap {
  constructor(instance) {
    this.call = instance.exports
    this.memory = instance.exports.memory
    this.top = this.memory.buffer.byteLength // below are the kernel's stack and constants
  }

  static async make(kernel) {
    return new Heap(await WebAssembly.instantiate(kernel, {}))
  }

  take(bytes) {
    const at = Math.ceil(this.top / 64) * 64
    this.top = at + Number(bytes)
    const missing = this.top - this.memory.buffer.byteLength
    if (missing > 0) this.memory.grow(Math.ceil(missing / 65536)) // a RangeError if there is no more
    return at
  }

  put(array) {
    const at = this.take(array.byteLength)
    new Uint8Array(this.memory.buffer, at, array.byteLength)
      .set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength))
    return at
  }

  /** Call a function, and release what it took. */
  borrow(work) {
    const top = this.top
    try { return work() } finally { this.top = top }
  }

  floats(at, count) { return new Float64Array(this.memory.buffer, at, count) }
  integers(at, count) { return new BigInt64Array(this.memory.buffer, at, count) }
  view(at) { return new DataView(this.memory.buffer, at) }

  // A structure of 64-bit numbers and 32-bit addresses.
  structure(integers, numbers, addresses) {
    const at = this.take(8 * (integers.length + numbers.length) + 4 * addresses.length), view = this.view(at)
    integers.forEach((value, i) => view.setBigInt64(8 * i, BigInt(value), true))
    numbers.forEach((value, i) => view.setFloat64(8 * (integers.length + i), value, true))
    addresses.forEach((value, i) => view.setUint32(8 * (integers.length + numbers.length) + 4 * i, value, true))
    return at
  }
}

function check(fault) {
  if (fault) throw new TypeError(`the kernel refuses a problem: ${FAULTS[Number(fault)]}`)
}

/** Write a problem into the heap; `fields` has SIZES and NUMBERS, `arrays` typed arrays by the names of ARRAYS. */
export function makeProblem(heap, fields, arrays) {
  const f = fields, n = f.sets * f.layers
  const counts = {boundaries: f.layers - 1, rigidity: f.sets, mu: n, thickness: n, friction: n, law: n * f.numbers,
    turn: f.bevels * f.sets, base: 3 * f.inputs * f.sets, before_first: f.inputs + 1, within_first: f.inputs + 1,
    held_tip: 2 * f.inputs}
  for (const [name, count] of Object.entries(counts)) {
    if (arrays[name].length !== count) throw new TypeError(`${name} has ${arrays[name].length} numbers, not ${count}`)
  }
  const addresses = ARRAYS.map(name => arrays[name] ? heap.put(arrays[name]) : 0)
  const at = heap.structure(SIZES.map(name => f[name]), NUMBERS.map(name => f[name]), addresses)
  const sizes = heap.take(24)
  check(heap.call.nf_check(at, sizes))
  const [room, points, quadrature] = heap.integers(sizes, 3)
  return {at, fields: f, arrays: Object.fromEntries(ARRAYS.map((name, i) => [name, addresses[i]])),
    room: Number(room), maxPoints: Number(points), maxQuadrature: Number(quadrature)}
}

/** Take room for the shapes of all sets; addresses by name. */
export function makeShapes(heap, problem, points) {
  const {sets, columns} = problem.fields, {room} = problem
  const counts = {x: room, u: room, slope: room, constraints: points, track: 2 * points, status: 1, passes: 1}
  const shapes = {points}
  for (const [name, count] of Object.entries(counts)) shapes[name] = heap.take(8 * sets * count)
  shapes.nodes = heap.take(8)
  for (const [name, count] of [['u_by', room], ['slope_by', room], ['constraints_by', points], ['track_by', points]]) {
    shapes[name] = columns ? heap.take(8 * sets * count * columns) : 0
  }
  const names = ['x', 'u', 'slope', 'constraints', 'track', 'status', 'passes', 'nodes', 'u_by', 'slope_by',
    'constraints_by', 'track_by']
  shapes.at = heap.structure([room, points], [], names.map(name => shapes[name]))
  return shapes
}

/** Simulate all sets of a problem, in lanes. */
export function simulate(heap, problem, shapes) {
  heap.borrow(() => {
    const lanes = heap.call.nf_lanes(), memory = heap.take(heap.call.nf_memory(problem.at, lanes))
    for (let first = 0n; first < problem.fields.sets; first += lanes) {
      check(heap.call.nf_simulate(problem.at, first, lanes, memory, shapes.at))
    }
  })
}

function readShape(heap, problem, shapes, points, depth, set = 0) {
  const count = Number(heap.integers(shapes.nodes, 1)[0])
  const read = (name, stride, used) => heap.floats(shapes[name] + 8 * set * stride, used).slice()
  return {
    status: STATUS[Number(heap.integers(shapes.status, set + 1)[set])],
    passes: Number(heap.integers(shapes.passes, set + 1)[set]), depth,
    x: read('x', problem.room, count), u: read('u', problem.room, count), slope: read('slope', problem.room, count),
    constraints: read('constraints', points, points), track: read('track', 2 * points, 2 * points)
  }
}

// ---- stops of the tip, as in mechanics/plan.py -------------------------------------------------------------------------

class Lattice {
  constructor(firstCell, spacing) { Object.assign(this, {firstCell, spacing}) }

  static endingAt(depth, spacing) {
    if (depth <= SAME_DEPTH) return new Lattice(spacing, spacing)
    const cells = Math.max(1, Math.ceil((depth - SAME_DEPTH) / spacing))
    return new Lattice(depth - (cells - 1) * spacing, spacing)
  }

  depth(m) { return m === 0 ? 0 : this.firstCell + (m - 1) * this.spacing }
  isAt(m, depth) { return Math.abs(this.depth(m) - depth) <= SAME_DEPTH }
  cell(depth) {
    if (depth <= SAME_DEPTH) return 0
    return 1 + Math.max(0, Math.ceil((depth - this.firstCell - SAME_DEPTH) / this.spacing))
  }
  locate(depth) {
    const cell = this.cell(depth)
    return this.isAt(cell, depth) ? [this.depth(cell), cell, true] : [depth, cell, false]
  }
  /** The depths of the constraint points behind a stop, and of the one under it. */
  list(stop) {
    const depths = Float64Array.from({length: stop.cell + 1}, (_, m) => this.firstCell + this.spacing * (m - 1))
    depths[0] = 0
    depths[stop.cell] = stop.tip
    return depths
  }
}

const sameInputs = (one, other) => one.bevel === other.bevel && one.controls === other.controls

/** Return the position after a move {depth, bevel, controls} (the latter two by number), and its stops. */
function planMove(position, move, lattice) {
  const stops = []
  let {ray} = position
  const halt = (depth, startsRay = false, extrapolates = false) => {
    const [tip, cell, permanent] = lattice.locate(depth)
    const bevel = ray ? ray.bevel : move.bevel
    stops.push({tip, cell, permanent, ray: ray ? ray.number : 0, startsRay, bevel, controls: move.controls, extrapolates})
    return stops.at(-1)
  }
  const here = position.last ?? halt(0)
  const inputsChanged = position.inputsChanged || !sameInputs(position.move ?? move, move)
  if (move.depth > here.tip + SAME_DEPTH) {
    let begins = !ray || here.permanent || inputsChanged || !sameInputs(ray, move)
    if (begins && here.controls !== move.controls) halt(here.tip)
    let at = here
    while (move.depth > at.tip + SAME_DEPTH) {
      let extrapolates = false
      if (begins) {
        const before = ray
        ray = {start: at.tip, bevel: move.bevel, controls: move.controls, number: before ? before.number + 1 : 0, before}
        extrapolates = at.permanent && at.cell > 0 && Boolean(before) && lattice.isAt(at.cell - 1, before.start) &&
          Math.abs(ray.start - before.start - lattice.spacing) <= 2 * SAME_DEPTH && sameInputs(before, ray)
      }
      const end = lattice.depth(at.permanent ? at.cell + 1 : at.cell)
      at = halt(Math.min(end, move.depth), begins, extrapolates)
      begins = true
    }
  } else if (move.depth < here.tip - SAME_DEPTH) {
    while (ray && ray.start >= move.depth - SAME_DEPTH) ray = ray.before
    halt(move.depth)
  } else if (here.controls !== move.controls) {
    halt(here.tip)
  }
  const stays = Math.abs(move.depth - here.tip) <= SAME_DEPTH
  return [{last: stops.at(-1) ?? here, ray, move, inputsChanged: inputsChanged && stays}, stops]
}

const flagsOf = stop =>
  PERMANENT * stop.permanent + STARTS_RAY * stop.startsRay + EXTRAPOLATES * stop.extrapolates

function writeStops(view, stops, bevelOf, inputsOf) {
  stops.forEach((stop, n) => {
    view.setFloat64(STOP_BYTES * n, stop.tip, true)
    const rest = [stop.cell, stop.ray, bevelOf(stop), inputsOf(stop), flagsOf(stop)]
    rest.forEach((value, i) => view.setBigInt64(STOP_BYTES * n + 8 * (i + 1), BigInt(value), true))
  })
}

function packStops(stops, bevelOf = () => 0, inputsOf = () => 0) {
  const packed = new Uint8Array(STOP_BYTES * stops.length)
  writeStops(new DataView(packed.buffer), stops, bevelOf, inputsOf)
  return packed
}

// ---- inputs ------------------------------------------------------------------------------------------------------------

function completeInputs(inputs) {
  const {bevel = {}, base = {}, guides = [], tip = null} = inputs
  return {
    bevel: {side: 1, strength: 0, ...bevel}, base: {y: 0, slope: 0, stageSlope: 0, ...base},
    guides: guides.map(guide => ({y: 0, slope: 0, ...guide})).sort((a, b) => a.x - b.x), tip
  }
}

const listGuides = guides => guides.flatMap(guide => [guide.x, guide.y, guide.slope ?? NaN])
const listTip = tip => tip ? [tip.y, tip.slope ?? NaN] : [NaN, NaN]
const listBase = base => [base.y, base.slope, base.stageSlope]
const turnOf = (bevel, model) => bevel.side * bevel.strength / (model.pathAngle ? 1 : model.spacing)
const bevelKey = ({bevel}) => JSON.stringify([bevel.side, bevel.strength])
const controlsKey = ({base, guides, tip}) => JSON.stringify([listBase(base), listGuides(guides), listTip(tip)])
const offsets = lists => BigInt64Array.from([0, ...lists].map((_, i) => BigInt(lists.slice(0, i).flat().length / 3)))

/** The fields and arrays of a problem; `inputs` are those of all stops, `values` (sets) take the place of the model's. */
function pack(model, lattice, inputs, stops, stopCount, values, more) {
  const sets = values.sets ?? 1, layers = model.mu.length
  const repeat = (name, given = model[name]) =>
    values[name] ?? Float64Array.from({length: sets * given.length}, (_, i) => given[i % given.length])
  const before = inputs.map(one => listGuides(one.guides.filter(guide => guide.x < 0)))
  const within = inputs.map(one => listGuides(one.guides.filter(guide => guide.x >= 0)))
  const spread = of => Float64Array.from(inputs.flatMap(one => Array.from({length: sets}, (_, i) => of(one, i)).flat()))
  const arrays = {
    boundaries: Float64Array.from(model.boundaries), stops, rigidity: repeat('rigidity', [model.rigidity]),
    mu: repeat('mu'), thickness: repeat('thickness'), friction: repeat('friction'), law: repeat('law'),
    turn: spread((one, i) => {
      const strength = values.strength ? values.strength[i] : one.bevel.strength
      return turnOf({...one.bevel, strength}, model)
    }),
    base: spread((one, i) => [
      values.baseY ? values.baseY[i] : one.base.y, values.baseSlope ? values.baseSlope[i] : one.base.slope,
      one.base.stageSlope
    ]),
    before_first: offsets(before), within_first: offsets(within),
    before: Float64Array.from(before.flat()), within: Float64Array.from(within.flat()),
    held_tip: Float64Array.from(inputs.flatMap(one => listTip(one.tip))), guide_x: values.guideX
  }
  const fields = {
    sets, layers, shapes: 1, terms: model.terms, numbers: model.law.length / layers, stop_count: stopCount,
    bevels: inputs.length, inputs: inputs.length, columns: 0, max_iterations: model.maxIterations ?? 40,
    length: model.length, first_cell: lattice.firstCell, spacing: lattice.spacing, element: model.element,
    part: model.pathAngle ? LINEAR_CUT : model.switch ?? 0.5, tangent: model.tangent ?? 1,
    tolerance: model.tolerance ?? 1e-7, guides: Math.max(...inputs.map(one => one.guides.length)), ...more
  }
  return [fields, arrays]
}

// ---- one needle, step by step -------------------------------------------------------------------------------------------

/** A needle that is inserted from its present state: the same bytes as `mechanics.session.Session`. */
export class Session {
  /** Begin at first contact. Each session has a memory of its own, which is freed with it. */
  static async begin(kernel, model, inputs = {}) {
    return new Session(await Heap.make(kernel), model, completeInputs(inputs))
  }

  constructor(heap, model, inputs) {
    Object.assign(this, {heap, model, inputs, depth: 0, position: {}, ids: new Map(), stopRoom: 16})
    this.lattice = new Lattice(model.firstCell, model.spacing)
    this.deepest = Math.min(model.length, MAX_ELEMENTS * model.element)
    this.rays = Math.ceil(this.deepest / model.spacing)
    this.base = heap.top
    this.#hold()
    this.#reserve()
    this.shape = this.#go(0, inputs)
  }

  // Write the problem of the present inputs; it has the same sizes each time.
  #hold() {
    const more = {rays: this.rays, guides: MAX_GUIDES, deepest: this.deepest}
    const stops = new Uint8Array(STOP_BYTES * this.stopRoom)
    this.heap.top = this.base
    const packed = pack(this.model, this.lattice, [this.inputs], stops, this.stopRoom, {}, more)
    packed[1].before = fill(packed[1].before, 3 * MAX_GUIDES) // so that later ones have room
    packed[1].within = fill(packed[1].within, 3 * MAX_GUIDES)
    this.problem = makeProblem(this.heap, ...packed)
    if (this.parts) this.heap.top = this.end
  }

  // Take memory for the state; `old` has that of fewer rays, which come last in it.
  #reserve(old) {
    const {heap, problem} = this, {call} = heap
    this.shapes = makeShapes(heap, problem, problem.maxPoints)
    const sizes = heap.take(24)
    call.nf_session_memory(problem.at, sizes)
    const [fixed, state, scratch] = heap.integers(sizes, 3).map(BigInt)
    const parts = {fixed: heap.take(fixed), now: heap.take(state), next: heap.take(state), scratch: heap.take(scratch)}
    Object.assign(this, {parts, bytes: state, end: heap.top})
    call.nf_session_begin(problem.at, parts.fixed, parts.now, parts.scratch)
    if (old) new Uint8Array(heap.memory.buffer).set(old, parts.now)
  }

  // Room for more rays or stops than before: everything is laid out anew.
  #enlarge(rays, stops) {
    const state = new Uint8Array(this.heap.memory.buffer, this.parts.now, Number(this.bytes)).slice()
    this.rays = rays > this.rays ? 2 * rays : this.rays
    this.stopRoom = Math.max(stops, this.stopRoom)
    this.parts = null
    this.#hold()
    this.#reserve(state)
  }

  /** Change inputs; those that are not given stay. The next step moves under them, or the needle adapts at once. */
  set(inputs) {
    const {bevel, base} = this.inputs
    const changed = completeInputs({...this.inputs, ...inputs, bevel: {...bevel, ...inputs.bevel},
      base: {...base, ...inputs.base}})
    return this.#go(this.depth, changed)
  }

  /** Insert by so many mm; returns the shape. Where its status is not "converged" the needle has stayed as it was. */
  advance(distance, inputs = this.inputs) { return this.#go(this.depth + distance, inputs) }

  /** Retract by so many mm, at most to the entry. */
  retract(distance) { return this.#go(Math.max(0, this.depth - distance), this.inputs) }

  #number(key) {
    if (!this.ids.has(key)) this.ids.set(key, this.ids.size)
    return this.ids.get(key)
  }

  #go(given, inputs) {
    const depth = Math.abs(given) < SAME_DEPTH ? 0 : given
    const front = Math.max(0, -Math.min(0, ...inputs.guides.map(guide => guide.x)))
    if (!(depth >= 0 && depth <= this.deepest && depth + front < this.model.length)) {
      throw new RangeError(`the needle cannot be ${depth} mm deep`)
    }
    const {heap} = this
    const move = {depth, bevel: this.#number(bevelKey(inputs)), controls: this.#number(controlsKey(inputs))}
    const [position, stops] = planMove(this.position, move, this.lattice)
    let {shape} = this
    if (stops.length) {
      const before = this.inputs, last = stops.at(-1)
      if (last.ray >= this.rays || stops.length > this.stopRoom) this.#enlarge(last.ray + 1, stops.length)
      this.inputs = inputs
      this.#hold()
      const {at, arrays} = this.problem, {fixed, now, next, scratch} = this.parts
      writeStops(heap.view(arrays.stops), stops, () => 0, () => 0)
      heap.view(at).setBigInt64(8 * SIZES.indexOf('stop_count'), BigInt(stops.length), true)
      heap.view(this.shapes.at).setBigInt64(8, BigInt(last.cell + 1), true)
      check(heap.call.nf_session_advance(at, fixed, now, this.bytes, next, scratch, this.shapes.at))
      shape = readShape(heap, this.problem, this.shapes, last.cell + 1, last.tip)
      if (shape.status !== STATUS[0]) {
        this.inputs = before
        return shape
      }
      [this.parts.now, this.parts.next] = [next, now]
    }
    Object.assign(this, {position, inputs, depth, shape})
    return shape
  }

  /** The points (K * 2: x and y, mm) of the needle at beam coordinates `s` (K), mm: 0 at the entry, depth at the tip. */
  positions(s) { return positions(this.heap, this.shape, s) }

  /** All loads across the needle as in `mechanics.load.compute_loads`: N, N mm, N/mm. */
  forces() {
    const {heap, shape, inputs, model, lattice} = this, {call} = heap
    return heap.borrow(() => {
      const last = this.position.last, depths = lattice.list(last), cells = last.cell, depth = last.tip
      const first = cells > 0 ? depths[1] : model.spacing
      const stop = {tip: depth, cell: 1, permanent: false, ray: 0, startsRay: false, extrapolates: false}
      const more = {rays: 1, deepest: Math.max(depths.length * model.spacing, depth) + first + 2 * model.spacing}
      const packed = pack(model, new Lattice(first, model.spacing), [inputs], packStops([stop]), 1, {}, more)
      const problem = makeProblem(heap, ...packed)
      const memory = heap.take(call.nf_memory(problem.at, 1n))
      const front = shape.x.findIndex(x => x >= 0), room = problem.maxQuadrature
      const [s, weight, layer, near] = [0, 1, 2, 3].map(() => heap.take(8 * room))
      const count = Number(call.nf_quadrature(problem.at, BigInt(shape.x.length - front), heap.put(shape.x.slice(front)),
        BigInt(cells), heap.put(depths), memory, s, weight, layer, near))
      if (count < 0) check(BigInt(FAULTS.indexOf('points')))
      const points = heap.put(Float64Array.from([...depths].flatMap((d, m) => [d, shape.constraints[m]])))
      const bent = heap.structure([shape.x.length, cells], [],
        [heap.put(shape.x), heap.put(shape.u), heap.put(shape.slope), points])
      const load = heap.take(8 * count), nodal = heap.take(16 * shape.x.length)
      call.nf_load(problem.at, bent, BigInt(count), s, memory, load)
      check(call.nf_balance(problem.at, bent, BigInt(front), BigInt(count), load, memory, nodal))
      const held = heap.floats(nodal, 2 * shape.x.length).slice()
      const supportAt = (x, clamped) => {
        const i = shape.x.indexOf(x)
        return {x, force: i < 0 ? 0 : held[2 * i], moment: i < 0 || !clamped ? 0 : held[2 * i + 1]}
      }
      const loads = {s: heap.floats(s, count).slice(), weight: heap.floats(weight, count).slice(),
        load: heap.floats(load, count).slice()}
      const nearest = heap.integers(near, count)
      return {
        ...loads,
        tipRegionForce: loads.load.reduce((sum, q, i) => sum + (nearest[i] === BigInt(cells) ? q * loads.weight[i] : 0), 0),
        base: supportAt(shape.x[0], true),
        guides: inputs.guides.map(guide => supportAt(guide.x, (guide.slope ?? null) !== null)),
        tip: inputs.tip ? supportAt(depth, (inputs.tip.slope ?? null) !== null) : {x: depth, force: 0, moment: 0}
      }
    })
  }
}

const fill = (array, length) => {
  const filled = new Float64Array(length)
  filled.set(array)
  return filled
}

function positions(heap, shape, s) {
  return heap.borrow(() => {
    const nodes = shape.x.length, out = heap.take(16 * s.length)
    const memory = heap.take(48 * (nodes + 2) * Number(heap.call.nf_lanes()))
    const arrays = [shape.x, shape.u, shape.slope, Float64Array.from(s)].map(array => heap.put(array))
    heap.call.nf_positions(1n, BigInt(nodes), BigInt(s.length), ...arrays, memory, out)
    return heap.floats(out, 2 * s.length).slice()
  })
}

// ---- many needles -------------------------------------------------------------------------------------------------------

/**
 * Simulate one insertion with many parameter sets.
 *
 * steps: [{depth, inputs}], the last of which ends on a constraint point. values: {sets, mu, thickness, friction (sets *
 * n), law (sets * n * numbers), rigidity, strength, baseY, baseSlope, guideX (sets)}, all but the first optional.
 * Resolves to {shapes, positions(i, s)}.
 */
export async function simulateBatch(kernel, model, steps, values) {
  const heap = await Heap.make(kernel), inputs = steps.map(step => completeInputs(step.inputs ?? {}))
  const first = (key, one) => inputs.findIndex(other => key(other) === key(one))
  const lattice = model.firstCell ? new Lattice(model.firstCell, model.spacing)
    : Lattice.endingAt(steps.at(-1).depth, model.spacing)
  let position = {}
  const stops = []
  steps.forEach(({depth}, n) => {
    const move = {depth, bevel: first(bevelKey, inputs[n]), controls: first(controlsKey, inputs[n])}
    const [next, more] = planMove(position, move, lattice)
    position = next
    stops.push(...more)
  })
  const more = {rays: 1 + Math.max(...stops.map(stop => stop.ray)), deepest: Math.max(...steps.map(step => step.depth))}
  const packed = packStops(stops, stop => stop.bevel, stop => stop.controls)
  const problem = makeProblem(heap, ...pack(model, lattice, inputs, packed, stops.length, values, more))
  const last = stops.at(-1), points = last.cell + 1, found = makeShapes(heap, problem, points)
  simulate(heap, problem, found)
  const shapes = Array.from({length: values.sets}, (_, i) => readShape(heap, problem, found, points, last.tip, i))
  return {shapes, positions: (i, s) => positions(heap, shapes[i], s)}
}
