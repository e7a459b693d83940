// Where the tip halts, which rays cut its path and which inputs hold the needle: as in mechanics/plan.py.

const SAME_DEPTH = 1e-9; // mm
const PERMANENT = 1;
const STARTS_RAY = 2;
const EXTRAPOLATES = 4;
export const STOP_BYTES = 48;

export class Lattice {
  constructor(firstCell, spacing) {
    Object.assign(this, { firstCell, spacing });
  }

  static endingAt(depth, spacing) {
    if (depth <= SAME_DEPTH) return new Lattice(spacing, spacing);
    const cells = Math.max(1, Math.ceil((depth - SAME_DEPTH) / spacing));
    return new Lattice(depth - (cells - 1) * spacing, spacing);
  }

  depth(m) {
    return m === 0 ? 0 : this.firstCell + (m - 1) * this.spacing;
  }
  isAt(m, depth) {
    return Math.abs(this.depth(m) - depth) <= SAME_DEPTH;
  }
  cell(depth) {
    if (depth <= SAME_DEPTH) return 0;
    return 1 + Math.max(0, Math.ceil((depth - this.firstCell - SAME_DEPTH) / this.spacing));
  }
  locate(depth) {
    const cell = this.cell(depth);
    return this.isAt(cell, depth) ? [this.depth(cell), cell, true] : [depth, cell, false];
  }
  /** The depths of the constraint points behind a stop, and of the one under it. */
  list(stop) {
    const depths = Float64Array.from(
      { length: stop.cell + 1 },
      (_, m) => this.firstCell + this.spacing * (m - 1),
    );
    depths[0] = 0;
    depths[stop.cell] = stop.tip;
    return depths;
  }
}

const sameInputs = (one, other) => one.bevel === other.bevel && one.controls === other.controls;

/** Return the position after a move {depth, bevel, controls} (the latter two by number), and its stops. */
export function planMove(position, move, lattice) {
  const stops = [];
  let { ray } = position;
  const halt = (depth, startsRay = false, extrapolates = false) => {
    const [tip, cell, permanent] = lattice.locate(depth);
    const bevel = ray ? ray.bevel : move.bevel;
    stops.push({
      tip,
      cell,
      permanent,
      ray: ray ? ray.number : 0,
      startsRay,
      bevel,
      controls: move.controls,
      extrapolates,
    });
    return stops.at(-1);
  };
  const here = position.last ?? halt(0);
  const inputsChanged = position.inputsChanged || !sameInputs(position.move ?? move, move);
  if (move.depth > here.tip + SAME_DEPTH) {
    let begins = !ray || here.permanent || inputsChanged || !sameInputs(ray, move);
    if (begins && here.controls !== move.controls) halt(here.tip);
    let at = here;
    while (move.depth > at.tip + SAME_DEPTH) {
      let extrapolates = false;
      if (begins) {
        const before = ray;
        ray = {
          start: at.tip,
          bevel: move.bevel,
          controls: move.controls,
          number: before ? before.number + 1 : 0,
          before,
        };
        extrapolates =
          at.permanent &&
          at.cell > 0 &&
          Boolean(before) &&
          lattice.isAt(at.cell - 1, before.start) &&
          Math.abs(ray.start - before.start - lattice.spacing) <= 2 * SAME_DEPTH &&
          sameInputs(before, ray);
      }
      const end = lattice.depth(at.permanent ? at.cell + 1 : at.cell);
      at = halt(Math.min(end, move.depth), begins, extrapolates);
      begins = true;
    }
  } else if (move.depth < here.tip - SAME_DEPTH) {
    while (ray && ray.start >= move.depth - SAME_DEPTH) ray = ray.before;
    halt(move.depth);
  } else if (here.controls !== move.controls) {
    halt(here.tip);
  }
  const stays = Math.abs(move.depth - here.tip) <= SAME_DEPTH;
  return [{ last: stops.at(-1) ?? here, ray, move, inputsChanged: inputsChanged && stays }, stops];
}

const flagsOf = (stop) =>
  PERMANENT * stop.permanent + STARTS_RAY * stop.startsRay + EXTRAPOLATES * stop.extrapolates;

export function writeStops(view, stops, bevelOf, inputsOf) {
  stops.forEach((stop, n) => {
    view.setFloat64(STOP_BYTES * n, stop.tip, true);
    const rest = [stop.cell, stop.ray, bevelOf(stop), inputsOf(stop), flagsOf(stop)];
    rest.forEach((value, i) => view.setBigInt64(STOP_BYTES * n + 8 * (i + 1), BigInt(value), true));
  });
}

export function packStops(stops, bevelOf = () => 0, inputsOf = () => 0) {
  const packed = new Uint8Array(STOP_BYTES * stops.length);
  writeStops(new DataView(packed.buffer), stops, bevelOf, inputsOf);
  return packed;
}
