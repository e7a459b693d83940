/** What stands still: air, layers and their names, skin, and axes in mm. */

import { ticks } from "d3-array";
import { brief, modulus } from "../quantities.js";
import { now } from "../store.js";
import { fromPx, fromPy, toPx, toPy, view } from "../view.js";
import { palette, polyline, setFont, shades, turned } from "./strokes.js";

const APART = 8; // px between the texts of two layers
const TICK = 5; // px
const TICKS_APART = 60; // px between ticks, about
const QUARTER = Math.PI / 2;

/** Draw the layers. */
export function paintTissue(context) {
  const { left, top, width, height } = view.box;
  context.fillStyle = palette.air;
  context.fillRect(left, top, width, height);
  const layers = listLayers();
  for (const { from, to, shade } of layers) {
    context.fillStyle = shade;
    context.fillRect(from, top, to - from, height);
  }
  for (const { from, number, top: edge } of layers) {
    if (edge < left) continue; // its upper side lies outside
    context.fillStyle = number === 1 ? palette.ink : palette.edge;
    context.fillRect(Math.round(from) - 0.5, top, number === 1 ? 1.5 : 1, height);
  }
  const axis = Math.round(toPy(0)) + 0.5;
  polyline(context, [[[left, axis], [left + width, axis]]], palette.quiet, 1, [5, 4]);
}

/** The layers that are in the window: their edges (px), shades and numbers. */
function listLayers() {
  const { boundaries_mm: tops, layer_names: names } = now.scene;
  const { left, width } = view.box;
  const depths = [0, ...tops, Infinity];
  const layers = shades(now.state.layers).map((shade, i) => ({
    shade, number: i + 1, name: names[i] || `layer ${i + 1}`, mu: now.state.layers[i].mu_pa,
    top: toPx(depths[i]), from: Math.max(toPx(depths[i]), left), to: Math.min(toPx(depths[i + 1]), left + width),
  }));
  return layers.filter(({ from, to }) => to > from);
}

/** Write above the window the name of each layer, or where names would meet its number, and its modulus where there is room. */
function paintNames(context) {
  const { left, top } = view.box;
  const layers = listLayers();
  const middle = ({ from, to }) => (from + to) / 2;
  setFont(context, "plain");
  const write = (texts, py) => {
    let end = -Infinity;
    texts.forEach((text, i) => {
      const half = context.measureText(text).width / 2;
      if (middle(layers[i]) - half < end + APART) return;
      context.fillText(text, middle(layers[i]), top + py);
      end = middle(layers[i]) + half;
    });
  };
  const named = layers.every(({ from, to, name }) => context.measureText(name).width <= to - from);
  write(layers.map(({ name, number }) => (named ? name : String(number))), -27);
  write(layers.map(({ mu }) => `μ ${modulus(mu)}`), -11);
  const skin = toPx(0);
  if (skin <= left + 40 || skin > left + view.box.width) return;
  context.textAlign = "right";
  context.fillText("skin", skin - 4, top - 11);
}

/** Draw the frame of the window, ticks across and the name of their axis. */
export function paintFrame(context, name) {
  const { left, top, width, height } = view.box;
  const bottom = top + height;
  context.lineWidth = 1;
  context.strokeStyle = palette.quiet;
  context.strokeRect(left - 0.5, top - 0.5, width + 1, height + 1);
  context.fillStyle = palette.label;
  setFont(context, "small", "right");
  const across = ticks(fromPy(bottom), fromPy(top), Math.max(height / TICKS_APART, 2)).map((y) => [y, Math.round(toPy(y)) + 0.5]);
  polyline(context, across.map(([, py]) => [[left - TICK, py], [left, py]]), palette.quiet, 1);
  for (const [y, py] of across) context.fillText(written(y), left - TICK - 2, py);
  context.textAlign = "center";
  turned(context, 11, top + height / 2, QUARTER, () => context.fillText(name, 0, 0));
}

/** Draw ticks and names outside the box. */
export function paintAxes(context) {
  const { left, top, width, height } = view.box;
  const bottom = top + height;
  setFont(context, "small");
  paintFrame(context, nameAcross(context, height));
  paintNames(context);

  setFont(context, "small", "center", "top");
  const along = ticks(fromPx(left), fromPx(left + width), width / TICKS_APART).map((x) => [x, Math.round(toPx(x)) + 0.5]);
  polyline(context, along.map(([, px]) => [[px, bottom], [px, bottom + TICK]]), palette.quiet, 1);
  for (const [x, px] of along) context.fillText(written(x), px, bottom + TICK + 2);
  context.fillText("x along the entry (mm)", left + width / 2, bottom + 26);
}

const written = (value) => brief(value, 6).replace("-", "−");

/** What stands along the axis, as long as there is room for. */
function nameAcross(context, room) {
  if (view.magnified === 1) return "y (mm)";
  const long = `y (mm), drawn ${view.magnified}× as large as x`;
  return context.measureText(long).width < room ? long : `y (mm), drawn ${view.magnified}×`;
}
