/** What stands still: air, layers and their names, skin, and axes in mm. */

import { extent, ticks } from "d3-array";
import { brief, modulus } from "../quantities.js";
import { measure, path, text, traceBox, turned } from "../sheet.js";
import { now } from "../store.js";
import { fromPx, fromPy, toPx, toPy, view } from "../view.js";
import { polyline } from "./strokes.js";

const APART = 8; // px between the texts of two layers
const TICK = 5; // px
const TICKS_APART = 60; // px between ticks, about
const QUARTER = Math.PI / 2;

/** Draw the layers: the stiffer, the darker, over one decade at least. */
export function paintTissue() {
  const { box } = view;
  path(traceBox(box), { fill: "air" });
  const layers = listLayers();
  const [soft, stiff] = /** @type {Point} */ (extent(now.state.layers, ({ mu_pa: mu }) => Math.log10(mu)));
  for (const { from, to, mu } of layers) {
    const edges = traceBox({ ...box, left: from, width: to - from });
    path(edges, { fill: "soft" });
    path(edges, { fill: "stiff", opacity: (Math.log10(mu) - soft) / Math.max(stiff - soft, 1) });
  }
  for (const { from, number, top: edge } of layers) {
    if (edge < box.left) continue; // its upper side lies outside
    const [fill, width] = number === 1 ? ["ink", 1.5] : ["edge", 1];
    path(traceBox({ ...box, left: Math.round(from) - 0.5, width }), { fill });
  }
  const axis = Math.round(toPy(0)) + 0.5;
  polyline([[[box.left, axis], [box.left + box.width, axis]]], "quiet", 1, [5, 4]);
}

/** The layers that are in the window: their edges (px), moduli and numbers. */
function listLayers() {
  const { boundaries_mm: tops, layer_names: names } = now.scene;
  const { left, width } = view.box;
  const depths = [0, ...tops, Infinity];
  const layers = now.state.layers.map(({ mu_pa: mu }, i) => ({
    mu, number: i + 1, name: names[i] || `layer ${i + 1}`,
    top: toPx(depths[i]), from: Math.max(toPx(depths[i]), left), to: Math.min(toPx(depths[i + 1]), left + width),
  }));
  return layers.filter(({ from, to }) => to > from);
}

/** Write above the window the name or number of each layer, and its modulus where there is room. */
function paintNames() {
  const { left, top, width } = view.box;
  const layers = listLayers();
  /** @param {string[]} texts @param {number} py */
  const write = (texts, py) => {
    let end = -Infinity;
    texts.forEach((words, i) => {
      const middle = (layers[i].from + layers[i].to) / 2;
      const half = measure(words, "plain") / 2;
      if (middle - half < end + APART) return;
      text(words, [middle, top + py], { font: "plain" });
      end = middle + half;
    });
  };
  const named = layers.every(({ from, to, name }) => measure(name, "plain") <= to - from);
  write(layers.map(({ name, number }) => (named ? name : String(number))), -27);
  write(layers.map(({ mu }) => `μ ${modulus(mu)}`), -11);
  const skin = toPx(0);
  if (skin > left + 40 && skin <= left + width) text("skin", [skin - 4, top - 11], { font: "plain", align: "end" });
}

/** Draw the frame of the window, ticks across and the name of their axis. @param {string} name */
export function paintFrame(name) {
  const { left, top, width, height } = view.box;
  path(traceBox({ left: left - 0.5, top: top - 0.5, width: width + 1, height: height + 1 }), { stroke: "quiet" });
  const across = ticks(fromPy(top + height), fromPy(top), Math.max(height / TICKS_APART, 2)).map((y) => [y, Math.round(toPy(y)) + 0.5]);
  polyline(across.map(([, py]) => [[left - TICK, py], [left, py]]), "quiet", 1);
  for (const [y, py] of across) text(written(y), [left - TICK - 2, py], { align: "end" });
  turned([11, top + height / 2], QUARTER, () => text(name, [0, 0]));
}

/** Draw ticks and names outside the box. */
export function paintAxes() {
  const { left, top, width, height } = view.box;
  const bottom = top + height;
  paintFrame(nameAcross(height));
  paintNames();
  const along = ticks(fromPx(left), fromPx(left + width), width / TICKS_APART).map((x) => [x, Math.round(toPx(x)) + 0.5]);
  polyline(along.map(([, px]) => [[px, bottom], [px, bottom + TICK]]), "quiet", 1);
  for (const [x, px] of along) text(written(x), [px, bottom + TICK + 8]);
  text("x along the entry (mm)", [left + width / 2, bottom + 31]);
}

/** @param {number} value */
const written = (value) => brief(value, 6).replace("-", "−");

/** What stands along the axis, as long as there is room for. @param {number} room */
function nameAcross(room) {
  if (view.magnified === 1) return "y (mm)";
  const long = `y (mm), drawn ${view.magnified}× as large as x`;
  return measure(long, "small") < room ? long : `y (mm), drawn ${view.magnified}×`;
}
