/** The pictures: slices with what was found drawn over them; clicks become places. */

import { NeedleSlice, PlaneSlice } from "./geometry.js";
import { button, colour, element } from "../dom.js";
import { post } from "../requests.js";

const NEAR = 2.5; // mm from a slice within which points are drawn on it
const LINE_NEAR = 4; // mm, of lines
const PIXELS = 900; // of a canvas, across: twice what most screens show
const WIDE = 600; // pixels of the screen from which on boundaries have their whole names
const BARS = [50, 20, 10, 5, 2, 1]; // mm, lengths of a scale bar
const WIDEST_BAR = 0.3; // of a picture's width
const DRAG = 4; // pixels of the screen from which on a press that moves pans
const [ZOOM_STEP, MAX_ZOOM] = [1.25, 20];
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const between = (low, value, high) => Math.min(Math.max(value, low), high);

class View {
  constructor(slice, state, act) {
    Object.assign(this, { slice, state, image: null, asked: 0, left: 0, top: 0, zoom: 1 });
    const along = slice.name === "needle";
    const name = along ? "along the needle" : slice.name;
    this.output = element("output");
    this.range = element("input", {
      type: "range", min: 0, step: 1, max: along ? 179 : slice.count - 1,
      ariaLabel: along ? "angle about the needle" : `${name} slice`,
    });
    const canvas = this.canvas = element("canvas", {
      tabIndex: 0, role: "application", ariaLabel: `${name}: click, or Enter, uses the tool; arrows move the point`,
    });
    const more = along ? [element("span", { className: "long" }, ", drawn straight")] : [];
    const zooms = [["−", "zoom out", 1 / ZOOM_STEP], ["+", "zoom in", ZOOM_STEP], ["fit", "show the whole", 0]].map(
      ([text, does, factor]) => button(text, () => this.magnify(factor), { ariaLabel: `${name}: ${does}` }),
    );
    const caption = element("figcaption", {}, element("span", {}, name, more), this.range, this.output, element("span", { className: "zooms" }, zooms));
    this.figure = element("figure", { className: slice.name }, caption, element("div", { className: "frame" }, canvas));
    this.range.addEventListener("input", () => this.turn(Number(this.range.value)));
    this.listen((x, y) => act.use(slice.place(x, y)));
    canvas.addEventListener("keydown", (event) => {
      const factor = { "+": ZOOM_STEP, "=": ZOOM_STEP, "-": 1 / ZOOM_STEP, 0: 0 }[event.key];
      if (factor !== undefined && !event.ctrlKey) this.magnify(factor, this.center());
      const step = STEPS[event.key];
      if (!step && event.key !== "Enter") return;
      event.preventDefault();
      if (step) act.look(this.moved(step.map((one) => one * (event.shiftKey ? 10 : 1))));
      else act.use(this.moved([0, 0]));
    });
    canvas.addEventListener("wheel", (event) => {
      const zooms = event.ctrlKey || event.metaKey;
      if (along && !zooms) return;
      event.preventDefault();
      if (zooms) this.magnify(ZOOM_STEP ** -Math.sign(event.deltaY), this.under(event));
      else this.turn(between(0, slice.position + Math.sign(event.deltaY), slice.count - 1));
    }, { passive: false });
  }

  /** A press uses the tool, one that moves pans, two pointers zoom. */
  listen(use) {
    const { canvas } = this;
    const held = new Map();
    let moved = false;
    const spread = () => {
      const [one, other] = [...held.values()];
      return Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, event);
      moved = held.size > 1;
      this.start = event;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const { start } = this;
      moved ||= Math.hypot(event.clientX - start.clientX, event.clientY - start.clientY) > DRAG;
      if (!moved) return;
      const wide = held.size === 2 ? spread() : 0;
      held.set(event.pointerId, event);
      if (wide) return this.magnify(spread() / wide, this.under(event));
      const [x, y] = this.under(before);
      const [toX, toY] = this.under(event);
      this.pan(this.left + x - toX, this.top + y - toY);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => {
        if (held.delete(event.pointerId) && !moved && end === "pointerup") use(...this.under(event));
      });
    }
  }

  /** The point of the picture under a pointer, in fractions of the whole. */
  under({ clientX, clientY }) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    return [this.left + (clientX - left) / width / this.zoom, this.top + (clientY - top) / height / this.zoom];
  }

  center() {
    return [this.left + 0.5 / this.zoom, this.top + 0.5 / this.zoom];
  }

  /** Zoom by a factor about a point of the picture; 0: show the whole. */
  magnify(factor, [x, y] = this.center()) {
    const zoom = between(1, this.zoom * factor, MAX_ZOOM);
    const keep = this.zoom / zoom;
    this.zoom = zoom;
    this.pan(x - (x - this.left) * keep, y - (y - this.top) * keep);
  }

  /** Show the part of the picture whose corner lies at these fractions. */
  pan(left, top) {
    const most = 1 - 1 / this.zoom;
    [this.left, this.top] = [between(0, left, most), between(0, top, most)];
    this.canvas.classList.toggle("zoomed", this.zoom > 1);
    this.draw();
  }

  /** Bring a place into the part that is shown. */
  reveal(place) {
    const [x, y] = this.slice.project(place);
    const hidden = (part, from) => part < from || part > from + 1 / this.zoom;
    if (hidden(x, this.left) || hidden(y, this.top)) this.pan(x - 0.5 / this.zoom, y - 0.5 / this.zoom);
  }

  /** Show the slice of an index, or at an angle. */
  turn(to) {
    this.slice.position = to;
    this.load();
  }

  /** The point of the crosshair on this slice, moved by pixels. */
  moved([right, down]) {
    const { state, slice } = this;
    const [x, y] = slice.project(state.cursor ?? state.place("tip") ?? slice.place(0.5, 0.5));
    if (!right && !down) return slice.place(x, y);
    const inside = (part, size) => between(0.5 / size, part, 1 - 0.5 / size);
    return slice.place(inside(x + right / slice.columns, slice.columns), inside(y + down / slice.rows, slice.rows));
  }

  /** Ask for the picture and draw it; of several requests the newest counts. */
  async load() {
    const { slice } = this;
    this.range.value = slice.position;
    this.output.textContent = slice.name === "needle" ? `${slice.position}°` : `${slice.position + 1} / ${slice.count}`;
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
    const width = canvas.width = Math.round(slice.columns * scale);
    const height = canvas.height = Math.round(canvas.width * slice.aspect);
    const paint = this.paint = canvas.getContext("2d");
    const unit = this.unit = width / (canvas.clientWidth || width); // canvas pixels of one on the screen
    paint.imageSmoothingEnabled = false;
    const { left, top, zoom } = this;
    if (this.image) paint.drawImage(this.image, -left * zoom * width, -top * zoom * height, zoom * width, zoom * height);
    for (const one of state.found.tubes) {
      if (!one.chosen) this.line(one.line, colour("other"), 1);
    }
    if (state.found.axis) this.line(state.found.axis, colour("needle"), 1.2);
    const kind = canvas.clientWidth > WIDE ? "boundary " : "";
    state.found.layers.forEach((one, n) => this.dot(one.at, colour("layer"), 4, slice.name === "needle" ? `${kind}${n + 1}` : "", 1));
    for (const one of state.found.proposed) this.dot(one.at, colour("proposed"), 3, "");
    if (state.found.error) for (const one of state.found.candidates) this.cross(one.at, colour("candidate"), 5);
    state.corrections.points?.forEach((at, n) => this.cross(at, colour("needle"), 6, `${n + 1}`));
    state.balls().forEach((ball, n) => this.cross(ball.at, colour("ball"), 7, `ball ${n + 1}`));
    for (const [kind, name] of [["contact", "entry"], ["tip", "tip"]]) {
      const at = state.place(kind);
      if (at) this.dot(at, colour(kind), 5, name);
    }
    if (state.corrections.needle) this.cross(state.corrections.needle, colour("needle"), 8);
    if (state.cursor) {
      const [x, y] = this.at(state.cursor);
      this.stroke([[[x, 0], [x, height]], [[0, y], [width, y]]], "#ffffff66", 1);
    }
    const edge = 10 * unit;
    const sides = [[edge, height / 2], [width - edge, height / 2], [width / 2, edge], [width / 2, height - edge]];
    slice.letters?.forEach((letter, n) => this.text(letter, ...sides[n], "#ffd866"));
    // a round length in the lower left corner
    const pixels = (zoom * width) / slice.width; // of a millimetre
    const length = BARS.find((one) => one * pixels < WIDEST_BAR * width) ?? BARS.at(-1);
    const [x, y] = [10 * unit, height - 10 * unit];
    for (const [colour, thick] of [["#000c", 4], ["#fff", 2]]) this.stroke([[[x, y], [x + length * pixels, y]]], colour, thick);
    this.text(`${length} mm`, x + (length * pixels) / 2, y - 10 * unit);
  }

  at(place) {
    const [x, y, away] = this.slice.project(place);
    const { left, top, zoom, canvas } = this;
    return [(x - left) * zoom * canvas.width, (y - top) * zoom * canvas.height, Math.abs(away)];
  }

  /** Draw lines, each a list of points, `width` pixels of the screen wide. */
  stroke(lines, colour, width) {
    const { paint } = this;
    paint.strokeStyle = colour;
    paint.lineWidth = width * this.unit;
    paint.beginPath();
    for (const [first, ...others] of lines) {
      paint.moveTo(...first);
      for (const one of others) paint.lineTo(...one);
    }
    paint.stroke();
  }

  /** Draw the parts of a line that are near to the slice. */
  line(points, colour, width) {
    const lines = [[]];
    for (const [x, y, away] of points.map((one) => this.at(one))) {
      if (away <= LINE_NEAR) lines.at(-1).push([x, y]);
      else lines.push([]);
    }
    this.stroke(lines.filter((one) => one.length), colour, width);
  }

  dot(place, fill, radius, name, side = -1) {
    const [x, y, away] = this.at(place);
    if (away > NEAR || x < 0 || y < 0 || x > this.canvas.width || y > this.canvas.height) return;
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

  cross(place, colour, reach, name = "") {
    const [x, y, away] = this.at(place);
    if (away > NEAR || x < 0 || y < 0 || x > this.canvas.width || y > this.canvas.height) return;
    const r = reach * this.unit;
    this.stroke([[[x - r, y], [x + r, y]], [[x, y - r], [x, y + r]]], colour, 2);
    this.text(name, x, y - r - 8 * this.unit);
  }

  /** Words about a point, inside the picture and readable on any grey. */
  text(words, x, y, fill = "#fff") {
    const { paint, canvas, unit } = this;
    paint.font = `${12 * unit}px system-ui, sans-serif`;
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    const half = paint.measureText(words).width / 2 + 3 * unit;
    const place = [between(half, x, canvas.width - half), Math.max(y, 8 * unit)];
    paint.strokeStyle = "#000c";
    paint.lineWidth = 3 * unit;
    paint.lineJoin = "round";
    paint.strokeText(words, ...place);
    paint.fillStyle = fill;
    paint.fillText(words, ...place);
  }
}

/** All pictures of a scan, made anew when something else was found. */
export class Views {
  constructor(holder, state, act) {
    Object.assign(this, { holder, state, act, all: [] });
  }

  /** Make the pictures of what was found; slices and what is shown of them stay, once the scan was examined. */
  make() {
    const { found } = this.state;
    const before = this.examined ? Object.fromEntries(this.all.map((one) => [one.slice.name, one])) : {};
    this.examined = found.examined;
    const slices = found.views.map((axes) => new PlaneSlice(found.grid, axes));
    if (found.tip) slices.forEach((slice) => slice.show(found.tip.at));
    if (found.course) slices.push(new NeedleSlice(found.course));
    this.all = slices.map((slice) => {
      const [view, same] = [new View(slice, this.state, this.act), before[slice.name]];
      if (same) {
        slice.position = same.slice.position;
        Object.assign(view, { image: same.image, left: same.left, top: same.top, zoom: same.zoom });
      }
      return view;
    });
    this.holder.replaceChildren(...this.all.map((one) => one.figure));
    this.load();
  }

  show(place) {
    for (const one of this.all) {
      one.slice.show?.(place);
      one.reveal(place);
    }
    this.load();
  }

  load() {
    for (const one of this.all) one.load();
  }

  draw() {
    for (const one of this.all) one.draw();
  }
}
