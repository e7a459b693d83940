/** Where a pixel of a slice lies in the patient (LPS, mm), and the other way round. */

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const less = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const distance = (a, b) => Math.hypot(...less(a, b));

/** The voxel index (i, j, k, fractional) of a place. */
export function toIndex(grid, place) {
  const from = less(place, grid.origin);
  return [0, 1, 2].map((n) => dot(from, grid.direction.map((row) => row[n])) / grid.spacing[n]);
}

/** The place of a voxel index. */
export function toPlace(grid, index) {
  return [0, 1, 2].map(
    (n) => grid.origin[n] + [0, 1, 2].reduce((sum, m) => sum + grid.direction[n][m] * grid.spacing[m] * index[m], 0),
  );
}

/** A slice along two axes of the volume. */
export class PlaneSlice {
  constructor(grid, axes) {
    Object.assign(this, axes, { grid });
    this.columns = grid.size[axes.right];
    this.rows = grid.size[axes.down];
    this.count = grid.size[axes.normal];
    this.width = this.columns * grid.spacing[axes.right]; // mm
    this.aspect = (this.rows * grid.spacing[axes.down]) / this.width;
    this.index = this.count >> 1;
  }

  /** What the server cuts. */
  get request() {
    return { view: this.name, index: this.index };
  }

  /** Go through a place. */
  show(place) {
    this.index = Math.min(Math.max(Math.round(toIndex(this.grid, place)[this.normal]), 0), this.count - 1);
  }

  /** Column, row (fractions of the picture) and the distance from the slice, mm. */
  project(place) {
    const index = toIndex(this.grid, place);
    const at = (axis, sign, size) => (sign > 0 ? index[axis] + 0.5 : size - 0.5 - index[axis]) / size;
    return [
      at(this.right, this.right_sign, this.columns),
      at(this.down, this.down_sign, this.rows),
      (index[this.normal] - this.index) * this.grid.spacing[this.normal],
    ];
  }

  /** The place of a point of the picture (fractions). */
  place(x, y) {
    const index = [0, 0, 0];
    const back = (part, sign, size) => (sign > 0 ? part * size - 0.5 : size - 0.5 - part * size);
    index[this.normal] = this.index;
    index[this.right] = back(x, this.right_sign, this.columns);
    index[this.down] = back(y, this.down_sign, this.rows);
    return toPlace(this.grid, index);
  }
}

/** The slice along the needle, which is drawn straight. */
export class NeedleSlice {
  constructor(course, angle) {
    Object.assign(this, course, { name: "needle", angle });
    this.columns = course.points.length;
    this.width = this.columns * this.pixel; // mm
    this.aspect = course.rows / this.columns;
  }

  get request() {
    return { view: "needle", angle: this.angle };
  }

  _across(n) {
    const [c, s] = [Math.cos((this.angle * Math.PI) / 180), Math.sin((this.angle * Math.PI) / 180)];
    return [0, 1, 2].map((m) => c * this.u[n][m] + s * this.v[n][m]);
  }

  project(place) {
    let nearest = 0;
    for (let n = 1; n < this.columns; n += 1) {
      if (distance(this.points[n], place) < distance(this.points[nearest], place)) nearest = n;
    }
    const from = less(place, this.points[nearest]);
    const aside = dot(from, this._across(nearest));
    return [
      (nearest + 0.5) / this.columns,
      ((this.half_width - aside) / this.pixel + 0.5) / this.rows,
      Math.sqrt(Math.max(0, dot(from, from) - aside * aside)),
    ];
  }

  place(x, y) {
    const n = Math.min(Math.max(Math.floor(x * this.columns), 0), this.columns - 1);
    const aside = this.half_width - (y * this.rows - 0.5) * this.pixel;
    const across = this._across(n);
    return this.points[n].map((value, m) => value + aside * across[m]);
  }
}
