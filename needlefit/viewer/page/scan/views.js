/** The pictures: slices with what was found drawn over them; clicks become places. */

import { NeedleSlice, PlaneSlice } from "./geometry.js";
import { ask } from "./server.js";

const NEAR = 2.5; // mm from a slice within which points are drawn on it
const LINE_NEAR = 4; // mm, of lines
const PIXELS = 900; // of a canvas, across: twice what most screens show

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

class View {
  constructor(slice, state, onPlace) {
    this.slice = slice;
    this.state = state;
    this.image = null;
    this.asked = 0;
    this.figure = document.createElement("figure");
    this.figure.className = slice.name;
    const caption = document.createElement("figcaption");
    const name = slice.name === "needle" ? "along the needle, drawn straight" : slice.name;
    this.output = document.createElement("output");
    this.range = Object.assign(document.createElement("input"), { type: "range", min: 0, step: 1 });
    this.range.setAttribute("aria-label", slice.name === "needle" ? "angle about the needle" : `${name} slice`);
    this.range.max = slice.name === "needle" ? 179 : slice.count - 1;
    caption.append(name, this.range, this.output);
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${name}: click to use the tool`);
    const frame = document.createElement("div");
    frame.className = "frame";
    frame.append(this.canvas);
    this.figure.append(caption, frame);
    this.range.addEventListener("input", () => {
      if (slice.name === "needle") slice.angle = Number(this.range.value);
      else slice.index = Number(this.range.value);
      this.load();
    });
    this.canvas.addEventListener("click", (event) => {
      const box = this.canvas.getBoundingClientRect();
      onPlace(slice.place((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height));
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

  /** Ask for the picture and draw it; of several requests the newest counts. */
  async load() {
    const { slice } = this;
    this.range.value = slice.name === "needle" ? slice.angle : slice.index;
    this.output.textContent = slice.name === "needle" ? `${slice.angle}°` : `${slice.index + 1} / ${slice.count}`;
    const [low, high] = this.state.window();
    this.asked += 1;
    const number = this.asked;
    try {
      const blob = await ask("cut", { ...slice.request, low, high });
      const image = await createImageBitmap(blob);
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
      if (!one.chosen) this.line(one.line, colour("--other"), 1);
    }
    if (state.found.axis) this.line(state.found.axis, colour("--needle"), 1.2);
    for (const one of state.found.layers) this.dot(one.at, colour("--layer"), 4);
    for (const ball of state.balls()) this.cross(ball.at, colour("--ball"), 7);
    const contact = state.place("contact");
    const tip = state.place("tip");
    if (contact) this.dot(contact, colour("--contact"), 5);
    if (tip) this.dot(tip, colour("--tip"), 5);
    if (state.corrections.needle) this.cross(state.corrections.needle, colour("--needle"), 8);
    if (state.cursor) this.hair(state.cursor);
    if (slice.letters) this.letters();
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

  dot(place, fill, radius) {
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
  }

  cross(place, stroke, reach) {
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
    const { paint, canvas, slice, unit } = this;
    const [left, right, top, bottom] = slice.letters;
    const edge = 10 * unit;
    paint.font = `${12 * unit}px system-ui, sans-serif`;
    paint.fillStyle = "#ffd866";
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    paint.fillText(left, edge, canvas.height / 2);
    paint.fillText(right, canvas.width - edge, canvas.height / 2);
    paint.fillText(top, canvas.width / 2, edge);
    paint.fillText(bottom, canvas.width / 2, canvas.height - edge);
  }
}

/** All pictures of a scan, made anew when something else was found. */
export class Views {
  constructor(place, state, onPlace) {
    Object.assign(this, { holder: place, state, onPlace, all: [] });
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
    this.all = slices.map((slice) => new View(slice, this.state, this.onPlace));
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
