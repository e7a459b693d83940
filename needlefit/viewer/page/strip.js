/** A pinned needle, and the strip below the picture: deflection and force of the tip against depth, of both needles. */

import { element, onScheme, part, press, write } from "./dom.js";
import { invalidate } from "./drawing.js";
import { palette, ring, segments, setFont, stroke, trace } from "./painters/strokes.js";
import { brief, heightAt, signed } from "./quantities.js";
import { listen, now, publish } from "./store.js";

const PAD = { left: 46, right: 12, top: 18, bottom: 16 }; // px
const canvas = element("canvas", {
  id: "strip-canvas", tabIndex: 0, role: "slider", ariaLabel: "Depth to read at", ariaValueMin: "0", ariaValueMax: "1", ariaValueNow: "0",
  title: "Tip against depth. Arrow keys or pointer mark a depth, Enter or a click goes there.",
});
part("strip").append(canvas, element("p", { id: "strip-note" }));
const context = canvas.getContext("2d");
let size = [1, 1]; // px

/** What is drawn against depth: its name, a shorter one, unit, decimals, and the curve of a needle. */
const PANELS = [
  ["tip y", "tip y", "mm", 2, ({ path }) => path],
  ["tip force at constraint points", "tip force", "N", 2, ({ forces }) => forces], // between them it rises and falls in each cell
];

/** The needle as it stands: its shape, the path of its tip, and the forces on the tip as it came to each constraint point. */
function current() {
  const { step, x, y, tip, tip_path: [along, across] } = now.state;
  return { step, x, y, tip, path: { x: [...along, tip.x], y: [...across, tip.y] }, forces: now.forces };
}

const needles = () => [[now.pinned, palette.ghost], [current(), palette.needle]].filter(([one]) => one);

/** The depth that brings the tip to x, mm: less by the length of the needle beyond. */
function depthAt(x) {
  const { state } = now;
  const beyond = state.x.flatMap((one, i) => (one > x ? [[one, state.y[i]]] : []));
  const places = [[x, heightAt(state, x)], ...beyond];
  const length = beyond.reduce((sum, [px, py], i) => sum + Math.hypot(px - places[i][0], py - places[i][1]), 0);
  return state.depth_mm - length + Math.max(x - state.tip.x, 0);
}

/** Draw both needles as they are now. */
export function draw() {
  if (part("strip").hidden || !now.state) return;
  const [width, height] = size;
  if (canvas.width !== Math.round(width * devicePixelRatio)) canvas.width = Math.round(width * devicePixelRatio);
  if (canvas.height !== Math.round(height * devicePixelRatio)) canvas.height = Math.round(height * devicePixelRatio);
  context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  context.clearRect(0, 0, width, height);
  describe(paintStrip(context, width, 0, height));
}

/** Draw both panels between two heights, px; return the greatest depth, mm. */
export function paintStrip(context, width, top, bottom) {
  const deep = greatest();
  PANELS.forEach((panel, n) => {
    const [left, right] = [(n * width) / 2 + PAD.left, ((n + 1) * width) / 2 - PAD.right];
    drawPanel(context, panel, deep, { left, right, top: top + PAD.top, bottom: bottom - PAD.bottom });
  });
  return deep;
}

/** The greatest depth that the strip shows, mm. */
const greatest = () => Math.max(now.scene.depth_mm, ...needles().map(([{ tip }]) => tip.x), 1);

/** The value of a curve at x, mm, or at its end nearby; NaN where the needle has not been. */
const valueAt = ([one, curve], x) => (x <= one.tip.x + now.scene.spacing_mm && curve.x.length ? heightAt(curve, x) : NaN);

function drawPanel(context, [long, short, unit, digits, curveOf], deep, { left, right, top, bottom }) {
  const curves = needles().map(([one, colour]) => [one, curveOf(one), colour]);
  const values = curves.flatMap(([, { y }]) => y);
  const [low, high] = [Math.min(0, ...values), Math.max(0, ...values)];
  const px = (x) => left + (x / deep) * (right - left);
  const py = (y) => bottom - ((y - low) / (high - low || 1)) * (bottom - top);
  segments(context, [[[left, py(0)], [right, py(0)]], [[left, top], [left, bottom]]], palette.quiet, 1);
  for (const [, { x, y }, colour] of curves) {
    trace(context, x.map((one, i) => [px(one), py(y[i])]));
    stroke(context, colour, 2);
  }
  const at = now.marked ?? now.state.tip.x;
  segments(context, [[[px(at), top], [px(at), bottom]]], now.marked === null ? palette.quiet : palette.accent, 1);
  for (const [one, curve, colour] of curves) {
    const value = valueAt([one, curve], at);
    if (!Number.isNaN(value)) ring(context, px(Math.min(at, curve.x.at(-1))), py(value), 3, colour, palette.air);
  }
  context.fillStyle = palette.label;
  setFont(context, "small", "left");
  const fits = context.measureText(`${long}, ${unit}`).width < right - left;
  context.fillText(`${fits ? long : short}, ${unit}`, left, top - 10);
  setFont(context, "small", "right");
  const ends = high - low < 10 ** -digits ? [[0, py(0)]] : [[low, bottom], [high, top]];
  for (const [value, place] of ends) context.fillText(String(Number(value.toFixed(digits)) || 0).replace("-", "−"), left - 4, place);
  context.textBaseline = "alphabetic";
  context.fillText(`${brief(deep, 3)} mm deep`, right, bottom + 13);
  context.textAlign = "left";
  context.fillText("0", left, bottom + 13);
}

/** The values at the depth that is marked, or at the tip, in words. */
function describe(deep) {
  const at = now.marked ?? now.state.tip.x;
  const read = (one) => PANELS.map(([, name, unit, digits, curve]) => {
    const value = valueAt([one, curve(one)], at);
    return `${name} ${Number.isNaN(value) ? "–" : `${signed(value, digits)} ${unit}`}`;
  }).join(", ");
  const words = needles().map(([one]) => `${one === now.pinned ? "pinned: " : ""}${read(one)}`).reverse().join("; ");
  const text = `At ${depthAt(at).toFixed(1)} mm (forces: at the last constraint point): ${words}`;
  write("strip-note", text);
  Object.assign(canvas, { ariaValueNow: at.toFixed(1), ariaValueMax: deep.toFixed(1), ariaValueText: text });
}

/** Mark a depth (x of the tip, mm; null: none) here and in the picture. */
function mark(x) {
  now.marked = x === null ? null : Math.max(0, Math.min(x, greatest()));
  invalidate();
  draw();
}

function under({ clientX }) {
  const { left, width } = canvas.getBoundingClientRect();
  const within = (clientX - left) % (width / 2);
  return ((within - PAD.left) / (width / 2 - PAD.left - PAD.right)) * greatest();
}

const go = () => now.marked !== null && publish("go to", Math.max(depthAt(now.marked), 0));
const KEYS = {
  ArrowRight: () => mark((now.marked ?? now.state.tip.x) + 1), ArrowLeft: () => mark((now.marked ?? now.state.tip.x) - 1),
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
listen("forces", draw);
listen("pinned forces", ({ step, ...forces }) => {
  if (now.pinned?.step === step) Object.assign(now.pinned, { forces });
  draw();
});
new ResizeObserver(() => {
  size = [canvas.clientWidth, canvas.clientHeight];
  draw();
}).observe(canvas);
onScheme(() => requestAnimationFrame(draw));
