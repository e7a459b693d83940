/** The pictures: slices with what was found drawn over them; clicks become places. */

import { NeedleSlice, PlaneSlice } from "./geometry.js";
import { colour, element } from "../dom.js";
import { post } from "../requests.js";

const NEAR = 2.5; // mm from a slice within which points are drawn on it
const LINE_NEAR = 4; // mm, of lines
const PIXELS = 900; // of a canvas, across: twice what most screens show
const WIDE = 600; // pixels of the screen from which on boundaries have their whole names
const BARS = [50, 20, 10, 5, 2, 1]; // mm, lengths of a scale bar
const WIDEST_BAR = 0.3; // of a picture's width
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

class View {
  constructor(slice, state, act) {
    this.slice = slice;
    this.state = state;
    this.image = null;
    this.asked = 0;
    const along = slice.name === "needle";
    const name = along ? "along the needle" : slice.name;
    this.output = element("output");
    this.range = element("input", {
      type: "range", min: 0, step: 1, max: along ? 179 : slice.count - 1,
      ariaLabel: along ? "angle about the needle" : `${name} slice`,
    });
    this.canvas = element("canvas", {
      tabIndex: 0, role: "application", ariaLabel: `${name}: click, or Enter, uses the tool; arrows move the point`,
    });
    const more = along ? [element("span", { className: "long" }, ", drawn straight")] : [];
    const caption = element("figcaption", {}, element("span", {}, name, more), this.range, this.output);
    this.figure = element("figure", { className: slice.name }, caption, element("div", { className: "frame" }, this.canvas));
    this.range.addEventListener("input", () => {
      if (slice.name === "needle") slice.angle = Number(this.range.value);
      else slice.index = Number(this.range.value);
      this.load();
    });
    this.canvas.addEventListener("click", (event) => {
      const box = this.canvas.getBoundingClientRect();
      act.use(slice.place((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height));
    });
    this.canvas.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (!step && event.key !== "Enter") return;
      event.preventDefault();
      const at = this.cursor();
      if (!step) act.use(at);
      else act.look(this.moved(at, step.map((one) => one * (event.shiftKey ? 10 : 1))));
    });
    this.canvas.addEventListener(
      "wheel",
      (event) => {
        if (slice.name === "needle") return;
        event.preventDefault();
        slice.index = Math.min(Math.max(slice.index + Math.sign(event.deltaY), 0), slice.count - 1);
        this.load();
      },
      { passive: false },
    );
  }

  /** The point of the crosshair, on this slice. */
  cursor() {
    const { state } = this;
    const [x, y] = this.slice.project(state.cursor ?? state.place("tip") ?? this.slice.place(0.5, 0.5));
    return this.slice.place(x, y);
  }

  /** A point moved by pixels. */
  moved(place, [right, down]) {
    const { slice } = this;
    const [x, y] = slice.project(place);
    const inside = (part, size) => Math.min(Math.max(part, 0.5 / size), 1 - 0.5 / size);
    return slice.place(inside(x + right / slice.columns, slice.columns), inside(y + down / slice.rows, slice.rows));
  }

  /** Ask for the picture and draw it; of several requests the newest counts. */
  async load() {
    const { slice } = this;
    this.range.value = slice.name === "needle" ? slice.angle : slice.index;
    this.output.textContent = slice.name === "needle" ? `${slice.angle}°` : `${slice.index + 1} / ${slice.count}`;
    const [low, high] = this.state.window();
    this.asked += 1;
    const number = this.asked;
    try {
      const answer = await post("/scan/cut", { ...slice.request, low, high });
      const image = await createImageBitmap(await answer.blob());
      if (number !== this.asked) return;
      this.image = image;
    } catch {
      this.image = null;
    }
    this.draw();
  }

  draw() {
    const { canvas, slice, state } = this;
    const scale = Math.max(1, PIXELS / slice.columns);
    canvas.width = Math.round(slice.columns * scale);
    canvas.height = Math.round(canvas.width * slice.aspect);
    const paint = canvas.getContext("2d");
    paint.imageSmoothingEnabled = false;
    if (this.image) paint.drawImage(this.image, 0, 0, canvas.width, canvas.height);
    const unit = canvas.width / (canvas.clientWidth || canvas.width); // canvas pixels of one on the screen
    this.paint = paint;
    this.unit = unit;
    for (const one of state.found.tubes) {
      if (!one.chosen) this.line(one.line, colour("other"), 1);
    }
    if (state.found.axis) this.line(state.found.axis, colour("needle"), 1.2);
    const kind = canvas.clientWidth > WIDE ? "boundary " : "";
    state.found.layers.forEach((one, n) => this.dot(one.at, colour("layer"), 4, slice.name === "needle" ? `${kind}${n + 1}` : "", 1));
    for (const one of state.found.proposed) this.dot(one.at, colour("proposed"), 3, "");
    state.balls().forEach((ball, n) => this.cross(ball.at, colour("ball"), 7, `ball ${n + 1}`));
    for (const [kind, name] of [["contact", "entry"], ["tip", "tip"]]) {
      const at = state.place(kind);
      if (at) this.dot(at, colour(`${kind}`), 5, name);
    }
    if (state.corrections.needle) this.cross(state.corrections.needle, colour("needle"), 8);
    if (state.cursor) this.hair(state.cursor);
    if (slice.letters) this.letters();
    this.scaleBar();
  }

  at(place) {
    const [x, y, away] = this.slice.project(place);
    return [x * this.canvas.width, y * this.canvas.height, Math.abs(away)];
  }

  line(points, stroke, width) {
    const { paint } = this;
    paint.strokeStyle = stroke;
    paint.lineWidth = width * this.unit;
    paint.beginPath();
    let drawn = false;
    for (const point of points) {
      const [x, y, away] = this.at(point);
      if (away > LINE_NEAR) drawn = false;
      else if (drawn) paint.lineTo(x, y);
      else {
        paint.moveTo(x, y);
        drawn = true;
      }
    }
    paint.stroke();
  }

  dot(place, fill, radius, name, side = -1) {
    const [x, y, away] = this.at(place);
    if (away > NEAR) return;
    const { paint } = this;
    paint.beginPath();
    paint.arc(x, y, radius * this.unit, 0, 2 * Math.PI);
    paint.fillStyle = fill;
    paint.fill();
    paint.strokeStyle = "#fff";
    paint.lineWidth = this.unit;
    paint.stroke();
    this.text(name, x, y + side * (radius + 9) * this.unit);
  }

  cross(place, stroke, reach, name = "") {
    const [x, y, away] = this.at(place);
    if (away > NEAR) return;
    const r = reach * this.unit;
    this.paint.strokeStyle = stroke;
    this.paint.lineWidth = 2 * this.unit;
    this.paint.beginPath();
    for (const [dx, dy] of [[r, 0], [0, r]]) {
      this.paint.moveTo(x - dx, y - dy);
      this.paint.lineTo(x + dx, y + dy);
    }
    this.paint.stroke();
    this.text(name, x, y - r - 8 * this.unit);
  }

  /** Words about a point, inside the picture and readable on any grey. */
  text(words, x, y, fill = "#fff") {
    const { paint, canvas, unit } = this;
    paint.font = `${12 * unit}px system-ui, sans-serif`;
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    const half = paint.measureText(words).width / 2 + 3 * unit;
    const place = [Math.min(Math.max(x, half), canvas.width - half), Math.max(y, 8 * unit)];
    paint.strokeStyle = "#000c";
    paint.lineWidth = 3 * unit;
    paint.lineJoin = "round";
    paint.strokeText(words, ...place);
    paint.fillStyle = fill;
    paint.fillText(words, ...place);
  }

  /** A round length in the lower left corner. */
  scaleBar() {
    const { paint, canvas, slice, unit } = this;
    const scale = canvas.width / slice.width; // pixels of a millimetre
    const length = BARS.find((one) => one * scale < WIDEST_BAR * canvas.width) ?? BARS.at(-1);
    const [x, y] = [10 * unit, canvas.height - 10 * unit];
    for (const [stroke, width] of [["#000c", 4], ["#fff", 2]]) {
      paint.strokeStyle = stroke;
      paint.lineWidth = width * unit;
      paint.beginPath();
      paint.moveTo(x, y);
      paint.lineTo(x + length * scale, y);
      paint.stroke();
    }
    this.text(`${length} mm`, x + (length * scale) / 2, y - 10 * unit);
  }

  hair(place) {
    const [x, y] = this.at(place);
    this.paint.strokeStyle = "#ffffff66";
    this.paint.lineWidth = this.unit;
    this.paint.beginPath();
    this.paint.moveTo(x, 0);
    this.paint.lineTo(x, this.canvas.height);
    this.paint.moveTo(0, y);
    this.paint.lineTo(this.canvas.width, y);
    this.paint.stroke();
  }

  letters() {
    const { canvas, slice, unit } = this;
    const [left, right, top, bottom] = slice.letters;
    const edge = 10 * unit;
    const yellow = "#ffd866";
    this.text(left, edge, canvas.height / 2, yellow);
    this.text(right, canvas.width - edge, canvas.height / 2, yellow);
    this.text(top, canvas.width / 2, edge, yellow);
    this.text(bottom, canvas.width / 2, canvas.height - edge, yellow);
  }
}

/** All pictures of a scan, made anew when something else was found. */
export class Views {
  constructor(place, state, act) {
    Object.assign(this, { holder: place, state, act, all: [] });
  }

  /** Make the pictures of what was found; slices stay where they were. */
  make() {
    const { found } = this.state;
    const before = new Map(this.all.map((one) => [one.slice.name, one.slice]));
    const slices = found.views.map((axes) => new PlaneSlice(found.grid, axes));
    const start = found.tip?.at;
    for (const slice of slices) {
      if (before.has(slice.name)) slice.index = before.get(slice.name).index;
      else if (start) slice.show(start);
    }
    if (found.course) slices.push(new NeedleSlice(found.course, before.get("needle")?.angle ?? 0));
    this.all = slices.map((slice) => new View(slice, this.state, this.act));
    this.holder.replaceChildren(...this.all.map((one) => one.figure));
    this.load();
  }

  show(place) {
    for (const { slice } of this.all) slice.show?.(place);
    this.load();
  }

  load() {
    for (const one of this.all) one.load();
  }

  draw() {
    for (const one of this.all) one.draw();
  }
}
