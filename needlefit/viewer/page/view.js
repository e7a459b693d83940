/** Which part of the constraint frame is seen, in true millimetres; y may be drawn larger than x. */

import { aim } from "./aim.js";
import { listen, now, publish } from "./store.js";

const GUTTER = { left: 56, right: 10, top: 10, bottom: 38 }; // px, for the axes
const MAGNIFICATIONS = [1, 2, 5, 10, 20, 50]; // of y against x
const VISIBLE = 0.45; // part of the window's height that deflections take at most when y is magnified for them
const LEAST_SPAN = 0.5; // mm; smaller deflections are not magnified further
const SCALES = [0.5, 400]; // px per mm
const [EDGE, AHEAD] = [0.3, 0.2]; // from the middle, parts of the window: when it follows the tip, and how far
const TALL = 0.8; // part of the window's height that needles may take
const SEEN = 0.42; // from the middle, part of the window's height: beyond it words cover the tip
const TIP_WINDOW = 45; // mm seen across while the tip is followed

/** The window: its centre (mm), its scale (px per mm), its box on the canvas (px). */
export const view = {
  x: 0, y: 0, scale: 5, magnified: 1, true: false, fit: null, box: { left: 0, top: 0, width: 1, height: 1 },
};

let changed = true;
let left = "tissue"; // what was shown before the picture was shifted or zoomed

/** Whether the window has changed since this was last asked. */
export function takeChange() {
  const was = changed;
  changed = false;
  return was;
}

/** Draw the window anew in the next frame. */
export function touch() {
  changed = true;
  publish("redraw");
}
export const toPx = (x) => view.box.left + view.box.width / 2 + (x - view.x) * view.scale;
export const toPy = (y) => view.box.top + view.box.height / 2 - (y - view.y) * view.scale * view.magnified;
export const fromPx = (px) => view.x + (px - view.box.left - view.box.width / 2) / view.scale;
export const fromPy = (py) => view.y - (py - view.box.top - view.box.height / 2) / (view.scale * view.magnified);

/** Give the window a canvas of so many px. */
export function resize(width, height) {
  view.box = {
    left: GUTTER.left, top: GUTTER.top,
    width: Math.max(width - GUTTER.left - GUTTER.right, 10),
    height: Math.max(height - GUTTER.top - GUTTER.bottom, 10),
  };
  fit(view.fit);
}

/** Show the whole needle, the tissue, or follow the tip; null leaves it as it is. */
export function fit(which) {
  view.fit = which;
  touch();
  if (!now.scene || !now.state || !which) return;
  if (which === "tip") {
    const { x, y } = now.state.tip;
    return Object.assign(view, { scale: limited(view.box.width / TIP_WINDOW), magnified: 1, x, y });
  }
  // From the base at first contact, or from the skin, to the greatest depth that is known; room in px for the base's
  // handle, or for the key of the load before the skin.
  const [low, high, before, after] = which === "whole"
    ? [-now.scene.length_mm, deepest() + 4, Math.min(74, 0.1 * view.box.width + 20), 12] : [0, 1.08 * deepest(), 84, 8];
  const room = view.box.width - before - after;
  const [bottom, top] = heights(which);
  const [along, across] = [room / (high - low), (TALL * view.box.height) / (top - bottom)];
  view.scale = limited(Math.min(along, across));
  // How many times as large as x the y axis is drawn, so that deflections can be seen.
  const times = (VISIBLE * view.box.height) / view.scale / Math.max(top - bottom, LEAST_SPAN);
  const plain = which === "whole" || view.true;
  view.magnified = plain ? 1 : MAGNIFICATIONS.filter((one) => one <= times).at(-1) ?? 1;
  view.x = (low + high) / 2 + (after - before) / (2 * view.scale);
  // The axis stays in the middle while all that must be seen is seen anyway.
  const half = (TALL * view.box.height) / 2 / (view.scale * view.magnified);
  view.y = top < half && bottom > -half ? 0 : (bottom + top) / 2;
}

function deepest() {
  const { depth_mm: depth, boundaries_mm: tops, measured } = now.scene;
  const goals = goalCircles().map(([x, , radius]) => x + radius);
  return Math.max(depth, now.state.depth_mm, (tops.at(-1) ?? 0) + 5, measured?.depth_mm ?? 0, ...goals);
}

/** Target and obstacles: x, y, radius. */
const goalCircles = () => [...(aim.target ? [[...aim.target, aim.radius]] : []), ...aim.obstacles];

/** Between which y all lies that must be seen: of the tissue alone what is in it. */
function heights(which) {
  const { x, y } = now.state;
  const seen = which === "whole" ? y : y.filter((_, i) => x[i] >= 0);
  const goals = goalCircles().flatMap(([, y, radius]) => [y - radius, y + radius]);
  const band = [now.band?.low.at(-1), now.band?.high.at(-1)].filter(Number.isFinite);
  const all = [...seen, ...(now.scene.measured?.y ?? []), ...goals, ...band, 0];
  return [Math.min(...all), Math.max(...all)];
}

export function seesTip() {
  const { left, top, width, height } = view.box;
  const [px, py] = [toPx(now.state.tip.x) - left, toPy(now.state.tip.y) - top];
  return px >= 0 && px <= width && py >= 0 && py <= height;
}

/** Keep the tip in sight: fit again once it leaves the window or the magnification does not suit it. */
export function follow() {
  if (view.fit && view.fit !== "tip") {
    const [bottom, top] = heights(view.fit);
    const tall = (top - bottom) * view.scale * view.magnified > TALL * view.box.height;
    const far = Math.abs(now.state.tip.y - view.y) * view.scale * view.magnified > SEEN * view.box.height;
    if (tall || far || !seesTip()) fit(view.fit);
    return;
  }
  if (view.fit !== "tip") return;
  const { x, y } = now.state.tip;
  const across = (x - view.x) * view.scale / view.box.width;
  const up = (y - view.y) * view.scale * view.magnified / view.box.height;
  if (Math.abs(across) < EDGE && Math.abs(up) < EDGE) return;
  view.x = x + Math.sign(across) * AHEAD * view.box.width / view.scale;
  view.y = y;
  touch();
}

/** Show again what was shown before the picture was shifted or zoomed. */
export const refit = () => fit(left);

function leave() {
  left = view.fit ?? left;
  view.fit = null;
}

/** Zoom by a factor about a point on the canvas (px), by default the middle. */
export function zoom(factor, px = toPx(view.x), py = toPy(view.y)) {
  const [x, y] = [fromPx(px), fromPy(py)];
  view.scale = limited(view.scale * factor);
  view.x += x - fromPx(px);
  view.y += y - fromPy(py);
  if (view.fit !== "tip") leave();
  touch();
}

export function pan(px, py) {
  view.x -= px / view.scale;
  view.y += py / (view.scale * view.magnified);
  leave();
  touch();
}

/** Draw y as large as x, or as large as it takes to see deflections. */
export function drawTrue(on) {
  view.true = on;
  if (on) view.magnified = 1;
  touch();
  fit(view.fit);
}

const limited = (scale) => Math.min(Math.max(scale, SCALES[0]), SCALES[1]);

/** A goal that is put or comes from a file is seen; while it is dragged the picture stands. */
listen("aim", () => view.fit && view.fit !== "tip" && fit(view.fit));
