/** A pinned needle, and the strip below the picture: deflection and force of the tip against depth, of both needles. */

import { element, onScheme, part, press } from "./dom.js";
import { invalidate } from "./drawing.js";
import { palette, ring, segments, setFont, stroke, trace } from "./painters/strokes.js";
import { brief, heightAt, signed } from "./quantities.js";
import { listen, now, publish } from "./store.js";

const PAD = { left: 46, right: 12, top: 18, bottom: 16 }; // px
const canvas = element("canvas", {
  id: "strip-canvas", tabIndex: 0, role: "slider", ariaLabel: "Depth to read at", ariaValueMin: "0", ariaValueMax: "1", ariaValueNow: "0",
  title: "Tip against depth. Arrow keys or pointer mark a depth, Enter or a click goes there.",
});
part("strip").append(canvas);
const context = canvas.getContext("2d");
let size = [1, 1]; // px

/** What is drawn against depth: its name, unit, decimals, and the curve of a needle. @type {[string, string, number, (one: any) => any][]} */
const PANELS = [
  ["tip y", "mm", 2, ({ path }) => path],
  ["tip force", "N", 2, ({ forces }) => forces],
];

/** The needle as it stands: its shape, and against depth the y of its tip and the tip force. */
function current() {
  const { step, depth_mm: depth, depths, x, y, tip, tip_path: [, across] } = now.state;
  return { step, depth, x, y, path: { x: [...depths, depth], y: [...across, tip.y] }, forces: now.forces };
}

const needles = () => [[now.pinned, palette.ghost], [current(), palette.needle]].filter(([one]) => one);

/** Draw both needles as they are now. */
function draw() {
  if (part("strip").hidden || !now.state) return;
  const [width, height] = size;
  if (canvas.width !== Math.round(width * devicePixelRatio)) canvas.width = Math.round(width * devicePixelRatio);
  if (canvas.height !== Math.round(height * devicePixelRatio)) canvas.height = Math.round(height * devicePixelRatio);
  context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  context.clearRect(0, 0, width, height);
  const deep = greatest();
  PANELS.forEach((panel, n) => {
    const [left, right] = [(n * width) / 2 + PAD.left, ((n + 1) * width) / 2 - PAD.right];
    drawPanel(panel, deep, { left, right, top: PAD.top, bottom: height - PAD.bottom });
  });
  describe(deep);
}

/** The greatest depth that the strip shows, mm. */
const greatest = () => Math.max(now.scene.depth_mm, ...needles().map(([{ depth }]) => depth), 1);

/** The value of a curve at a depth, mm; NaN where the needle has not been. */
const valueAt = ([one, curve], at) => (at <= one.depth + 1e-9 && curve.x.length ? heightAt(curve, at) : NaN);

function drawPanel([name, unit, digits, curveOf], deep, { left, right, top, bottom }) {
  const curves = needles().map(([one, colour]) => [one, curveOf(one), colour]);
  const values = curves.flatMap(([, { y }]) => y);
  const [low, high] = [Math.min(0, ...values), Math.max(0, ...values)];
  const px = (depth) => left + (depth / deep) * (right - left);
  const py = (y) => bottom - ((y - low) / (high - low || 1)) * (bottom - top);
  segments(context, [[[left, py(0)], [right, py(0)]], [[left, top], [left, bottom]]], palette.quiet, 1);
  for (const [, { x, y }, colour] of curves) {
    trace(context, x.map((one, i) => [px(one), py(y[i])]));
    stroke(context, colour, 2);
  }
  const at = now.marked ?? now.state.depth_mm;
  segments(context, [[[px(at), top], [px(at), bottom]]], now.marked === null ? palette.quiet : palette.accent, 1);
  context.fillStyle = palette.label;
  setFont(context, "small", "left");
  let read = `${name}, ${unit}`;
  for (const [one, curve, colour] of curves.toReversed()) {
    const value = valueAt([one, curve], at);
    if (Number.isNaN(value)) continue;
    ring(context, px(Math.min(at, curve.x.at(-1))), py(value), 3, colour, palette.air);
    if (now.marked !== null) read += `${one === now.pinned ? ", pinned" : ":"} ${signed(value, digits)}`;
  }
  context.fillStyle = palette.label;
  context.fillText(read, left, top - 10);
  setFont(context, "small", "right");
  const ends = high - low < 10 ** -digits ? [[0, py(0)]] : [[low, bottom], [high, top]];
  for (const [value, place] of ends) context.fillText(String(Number(value.toFixed(digits)) || 0).replace("-", "−"), left - 4, place);
  context.textBaseline = "alphabetic";
  context.fillText(`depth ${brief(now.marked ?? deep, 3)} mm`, now.marked === null ? right : Math.min(px(at) + 30, right), bottom + 13);
  context.textAlign = "left";
  context.fillText("0", left, bottom + 13);
}

/** The values at the depth that is marked, or at the tip, in words. */
function describe(deep) {
  const at = now.marked ?? now.state.depth_mm;
  const read = (one) => PANELS.map(([name, unit, digits, curve]) => {
    const value = valueAt([one, curve(one)], at);
    return `${name} ${Number.isNaN(value) ? "–" : `${signed(value, digits)} ${unit}`}`;
  }).join(", ");
  const words = needles().map(([one]) => `${one === now.pinned ? "pinned: " : ""}${read(one)}`).reverse().join("; ");
  Object.assign(canvas, { ariaValueNow: at.toFixed(1), ariaValueMax: deep.toFixed(1), ariaValueText: `At ${at.toFixed(1)} mm: ${words}` });
}

/** Mark a depth (mm; null: none) here and in the picture. */
function mark(depth) {
  now.marked = depth === null ? null : Math.max(0, Math.min(depth, greatest()));
  invalidate();
  draw();
}

function under({ clientX }) {
  const { left, width } = canvas.getBoundingClientRect();
  const within = (clientX - left) % (width / 2);
  return ((within - PAD.left) / (width / 2 - PAD.left - PAD.right)) * greatest();
}

const go = () => now.marked !== null && publish("go to", now.marked);
const KEYS = {
  ArrowRight: () => mark((now.marked ?? now.state.depth_mm) + 1), ArrowLeft: () => mark((now.marked ?? now.state.depth_mm) - 1),
  Home: () => mark(0), End: () => mark(greatest()), Enter: go, Escape: () => mark(null),
};
canvas.addEventListener("keydown", (event) => {
  if (!(event.key in KEYS) || !now.state) return;
  event.preventDefault();
  event.stopPropagation(); // here they do not move the needle
  KEYS[event.key]();
});
canvas.addEventListener("pointermove", (event) => now.state && mark(under(event)));
for (const kind of ["pointerleave", "blur"]) canvas.addEventListener(kind, () => now.state && mark(null));
press(canvas, (event) => now.state && (mark(under(event)), go()));

/** Keep the needle as it stands to compare with, or forget the one that was kept. */
export function pin() {
  now.pinned = now.pinned ? null : current();
  part("pin").ariaPressed = String(now.pinned !== null);
  part("pin").textContent = now.pinned ? "Unpin" : "Pin";
  publish("pinned");
  invalidate();
  draw();
}

press("pin", () => now.state && pin());
listen("scene", () => [now.forces, now.marked] = [{ x: [], y: [] }, null]);
listen("state", draw);
listen("forces", (forces) => {
  if (now.pinned?.step === forces.step) now.pinned.forces = forces;
  draw();
});
new ResizeObserver(() => {
  size = [canvas.clientWidth, canvas.clientHeight];
  draw();
}).observe(canvas);
onScheme(() => requestAnimationFrame(draw));
