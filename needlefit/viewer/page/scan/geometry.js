/** Where a pixel of a slice lies in the patient (LPS, mm), and the other way round. */

const AXES = [0, 1, 2];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const less = (a, b) => a.map((value, n) => value - b[n]);
const distance = (a, b) => Math.hypot(...less(a, b));
const between = (low, value, high) => Math.min(Math.max(value, low), high);

/** The voxel index (i, j, k, fractional) of a place. */
function toIndex({ origin, direction, spacing }, place) {
  const from = less(place, origin);
  return AXES.map((n) => dot(from, direction.map((row) => row[n])) / spacing[n]);
}

/** A slice along two axes of the volume; its `position` is an index. */
export class PlaneSlice {
  constructor(grid, axes) {
    Object.assign(this, axes, { grid });
    this.columns = grid.size[axes.right];
    this.rows = grid.size[axes.down];
    this.count = grid.size[axes.normal];
    this.width = this.columns * grid.spacing[axes.right]; // mm
    this.aspect = (this.rows * grid.spacing[axes.down]) / this.width;
    this.position = this.count >> 1;
  }

  /** What the server cuts. */
  get request() {
    return { view: this.name, index: this.position };
  }

  show(place) {
    this.position = between(0, Math.round(toIndex(this.grid, place)[this.normal]), this.count - 1);
  }

  /** Column, row (fractions of the picture) and the distance from the slice, mm. */
  project(place) {
    const index = toIndex(this.grid, place);
    const at = (axis, sign, size) => (sign > 0 ? index[axis] + 0.5 : size - 0.5 - index[axis]) / size;
    return [
      at(this.right, this.right_sign, this.columns),
      at(this.down, this.down_sign, this.rows),
      (index[this.normal] - this.position) * this.grid.spacing[this.normal],
    ];
  }

  /** The place of a point of the picture (fractions). */
  place(x, y) {
    const { origin, direction, spacing } = this.grid;
    const back = (part, sign, size) => (sign > 0 ? part * size - 0.5 : size - 0.5 - part * size);
    const index = [0, 0, 0];
    index[this.normal] = this.position;
    index[this.right] = back(x, this.right_sign, this.columns);
    index[this.down] = back(y, this.down_sign, this.rows);
    return AXES.map((n) => origin[n] + AXES.reduce((sum, m) => sum + direction[n][m] * spacing[m] * index[m], 0));
  }
}

/** The slice along the needle, which is drawn straight; its `position` is an angle about it, in degrees. */
export class NeedleSlice {
  constructor(course) {
    Object.assign(this, course, { name: "needle", position: 0 });
    this.columns = course.points.length;
    this.width = this.columns * this.pixel; // mm
    this.aspect = course.rows / this.columns;
  }

  get request() {
    return { view: "needle", angle: this.position };
  }

  _across(n) {
    const [c, s] = [Math.cos((this.position * Math.PI) / 180), Math.sin((this.position * Math.PI) / 180)];
    return AXES.map((m) => c * this.u[n][m] + s * this.v[n][m]);
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
    const n = between(0, Math.floor(x * this.columns), this.columns - 1);
    const aside = this.half_width - (y * this.rows - 0.5) * this.pixel;
    const across = this._across(n);
    return this.points[n].map((value, m) => value + aside * across[m]);
  }
}
