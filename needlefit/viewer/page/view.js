/** Which part of the constraint frame is seen, in true millimetres; y may be drawn larger than x. */

import { extent } from "d3-array";
import { listen, now, redraw } from "./store.js";

const GUTTER = { left: 56, right: 10, top: 50, bottom: 40 }; // px, for the axes and the names of layers
const MAGNIFICATIONS = [1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30, 50]; // of y against x
const ROOM = 56; // px above and below the needle, for labels; at most 0.2 of the height
const LEAST_SPAN = 0.01; // of the depth: smaller deflections are not magnified further
const LOW = 0.45; // part of the room below which a needle at rest is magnified anew
const TIP_WINDOW = 45; // mm seen across while the tip is followed
const SCALES = /** @type {const} */ ([0.5, 400]); // px per mm to which the reader can zoom

/** The window: its centre (mm), its scale (px per mm), its box on the canvas (px); what it fits, of which scene. @type {View} */
export const view = { x: 0, y: 0, scale: 5, magnified: 1, fit: "tissue", of: null, box: { left: 0, top: 0, width: 1, height: 1 } };

Object.assign(now, { view });
/** @type {Scale} */
export const toPx = (x) => view.box.left + view.box.width / 2 + (x - view.x) * view.scale;
/** @type {Scale} */
export const toPy = (y) => view.box.top + view.box.height / 2 - (y - view.y) * view.scale * view.magnified;
/** @type {Scale} */
export const fromPx = (px) => view.x + (px - view.box.left - view.box.width / 2) / view.scale;
/** @type {Scale} */
export const fromPy = (py) => view.y - (py - view.box.top - view.box.height / 2) / (view.scale * view.magnified);

/** Draw through another window. @template T @param {Partial<View>} window @param {() => T} draw */
export function look(window, draw) {
  const kept = { ...view };
  Object.assign(view, window);
  try {
    return draw();
  } finally {
    Object.assign(view, kept);
  }
}

/** Give the window a canvas of so many px. @param {number} width @param {number} height */
export function resize(width, height) {
  view.box = {
    left: GUTTER.left, top: GUTTER.top,
    width: Math.max(width - GUTTER.left - GUTTER.right, 10),
    height: Math.max(height - GUTTER.top - GUTTER.bottom, 10),
  };
  fit(view.fit);
}

/** Show the whole needle, the tissue, the tip at its true scale, or what the reader has moved the window to. @param {View["fit"]} which */
export function fit(which) {
  view.fit = which;
  redraw();
  if (!now.scene || !now.state || which === "moved") return;
  if (which === "tip") {
    const { x, y } = now.state.tip;
    return Object.assign(view, { scale: view.box.width / TIP_WINDOW, magnified: 1, x, y });
  }
  // From the base at first contact, or from the skin, to the greatest depth that is known; room in px for the hub, and
  // for the names of lines behind their ends.
  const [low, high, before, after] = which === "whole"
    ? [-now.scene.length_mm, deepest() + 4, Math.min(74, 0.1 * view.box.width + 20), 34] : [0, 1.04 * deepest(), Math.min(44, 0.1 * view.box.width), Math.min(84, 0.12 * view.box.width)];
  const room = view.box.width - before - after;
  const [bottom, top] = heights();
  const [along, across] = [room / (high - low), roomAcross() / (top - bottom)];
  view.scale = Math.min(along, across);
  // How many times as large as x the y axis is drawn, so that deflections can be seen.
  const least = LEAST_SPAN * deepest();
  const times = roomAcross() / view.scale / Math.max(top - bottom, least);
  view.magnified = MAGNIFICATIONS.filter((one) => one <= times).at(-1) ?? 1;
  view.x = (low + high) / 2 + (after - before) / (2 * view.scale);
  view.y = (bottom + top) / 2;
}

/** Zoom by a factor about a place on the canvas, px. @param {number} factor @param {Point} place */
export function zoom(factor, [px, py] = [toPx(view.x), toPy(view.y)]) {
  const [x, y] = [fromPx(px), fromPy(py)];
  view.scale = Math.min(Math.max(view.scale * factor, SCALES[0]), SCALES[1]);
  view.x += x - fromPx(px);
  view.y += y - fromPy(py);
  fit("moved");
}

/** Shift what is seen, px. @param {number} px @param {number} py */
export function pan(px, py) {
  view.x -= px / view.scale;
  view.y += py / (view.scale * view.magnified);
  fit("moved");
}

/** Px that what must be seen may take of the window's height. */
const roomAcross = () => view.box.height - 2 * Math.min(ROOM, 0.2 * view.box.height);

function deepest() {
  const { depth_mm: depth, boundaries_mm: tops, measured } = now.scene;
  const goals = goalCircles().map(([x, , radius]) => x + radius);
  return Math.max(depth, now.state.depth_mm, (tops.at(-1) ?? 0) + 5, measured?.depth_mm ?? 0, ...goals);
}

/** Target and obstacles: x, y, radius. */
function goalCircles() {
  const { plan } = now.scene;
  return plan ? [[...plan.target, plan.radius], ...plan.obstacles.map(([x, y, radius]) => [x, y, radius])] : [];
}

/** Between which y all lies that must be seen: of the tissue alone what is in it. */
function heights() {
  const { state, band, pinned, scene: { measured } } = now;
  const seen = [state, pinned].flatMap((one) => (one ? one.y.filter((_, i) => view.fit === "whole" || one.x[i] >= 0) : []));
  const goals = goalCircles().flatMap(([, y, radius]) => [y - radius, y + radius]);
  return /** @type {Point} */ (extent([...seen, ...(measured?.y ?? []), ...goals, ...(band?.low ?? []), ...(band?.high ?? []), 0]));
}

/** Whether the tip is in the window. */
function seesTip() {
  const { left, top, width, height } = view.box;
  const { x, y } = now.state.tip;
  const [px, py] = [toPx(x) - left, toPy(y) - top];
  return px >= 0 && px <= width && py >= 0 && py <= height;
}

/** Keep the needle in sight: fit again once it leaves the room it has, or is small in it. */
export function follow() {
  const anew = view.of !== now.scene;
  view.of = now.scene;
  if (view.fit === "moved" && !anew) return;
  if (anew || view.fit === "tip") return fit(view.fit === "moved" ? "tissue" : view.fit);
  const [bottom, top] = heights();
  const px = view.scale * view.magnified;
  const out = Math.max(top - view.y, view.y - bottom) * px > roomAcross() / 2 + 1 || !seesTip();
  const low = (top - bottom) * px < LOW * roomAcross();
  if (out || (low && view.magnified < MAGNIFICATIONS[MAGNIFICATIONS.length - 1])) fit(view.fit);
}

listen("band", follow);
