/** What stands still: air, layers and their names, skin, and axes in mm. */

import { ticks } from "d3-array";
import { brief, modulus } from "../quantities.js";
import { measure, traceBox } from "../sheet.js";
import { now } from "../store.js";
import { fromPx, fromPy, toPx, toPy, view } from "../view.js";
import { palette, polyline, shades } from "./strokes.js";

const APART = 8; // px between the texts of two layers
const TICK = 5; // px
const TICKS_APART = 60; // px between ticks, about
const QUARTER = Math.PI / 2;

/** Draw the layers. @param {Sheet} sheet */
export function paintTissue(sheet) {
  const { box } = view;
  sheet.path(traceBox(box), { fill: palette.air });
  const layers = listLayers();
  for (const { from, to, shade } of layers) sheet.path(traceBox({ ...box, left: from, width: to - from }), { fill: shade });
  for (const { from, number, top: edge } of layers) {
    if (edge < box.left) continue; // its upper side lies outside
    const [fill, width] = number === 1 ? [palette.ink, 1.5] : [palette.edge, 1];
    sheet.path(traceBox({ ...box, left: Math.round(from) - 0.5, width }), { fill });
  }
  const axis = Math.round(toPy(0)) + 0.5;
  polyline(sheet, [[[box.left, axis], [box.left + box.width, axis]]], palette.quiet, 1, [5, 4]);
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

/** Write above the window the name of each layer, or where names would meet its number, and its modulus where there is room. @param {Sheet} sheet */
function paintNames(sheet) {
  const { left, top, width } = view.box;
  const layers = listLayers();
  /** @param {string[]} texts @param {number} py */
  const write = (texts, py) => {
    let end = -Infinity;
    texts.forEach((text, i) => {
      const middle = (layers[i].from + layers[i].to) / 2;
      const half = measure(text, "plain") / 2;
      if (middle - half < end + APART) return;
      sheet.text(text, [middle, top + py], { fill: palette.label, font: "plain" });
      end = middle + half;
    });
  };
  const named = layers.every(({ from, to, name }) => measure(name, "plain") <= to - from);
  write(layers.map(({ name, number }) => (named ? name : String(number))), -27);
  write(layers.map(({ mu }) => `μ ${modulus(mu)}`), -11);
  const skin = toPx(0);
  if (skin > left + 40 && skin <= left + width) sheet.text("skin", [skin - 4, top - 11], { fill: palette.label, font: "plain", align: "end" });
}

/** Draw the frame of the window, ticks across and the name of their axis. @param {Sheet} sheet @param {string} name */
export function paintFrame(sheet, name) {
  const { left, top, width, height } = view.box;
  sheet.path(traceBox({ left: left - 0.5, top: top - 0.5, width: width + 1, height: height + 1 }), { stroke: palette.quiet });
  const across = ticks(fromPy(top + height), fromPy(top), Math.max(height / TICKS_APART, 2)).map((y) => [y, Math.round(toPy(y)) + 0.5]);
  polyline(sheet, across.map(([, py]) => [[left - TICK, py], [left, py]]), palette.quiet, 1);
  for (const [y, py] of across) sheet.text(written(y), [left - TICK - 2, py], { fill: palette.label, align: "end" });
  sheet.turned([11, top + height / 2], QUARTER, () => sheet.text(name, [0, 0], { fill: palette.label }));
}

/** Draw ticks and names outside the box. @param {Sheet} sheet */
export function paintAxes(sheet) {
  const { left, top, width, height } = view.box;
  const bottom = top + height;
  paintFrame(sheet, nameAcross(height));
  paintNames(sheet);
  const along = ticks(fromPx(left), fromPx(left + width), width / TICKS_APART).map((x) => [x, Math.round(toPx(x)) + 0.5]);
  polyline(sheet, along.map(([, px]) => [[px, bottom], [px, bottom + TICK]]), palette.quiet, 1);
  for (const [x, px] of along) sheet.text(written(x), [px, bottom + TICK + 8], { fill: palette.label });
  sheet.text("x along the entry (mm)", [left + width / 2, bottom + 31], { fill: palette.label });
}

/** @param {number} value */
const written = (value) => brief(value, 6).replace("-", "−");

/** What stands along the axis, as long as there is room for. @param {number} room */
function nameAcross(room) {
  if (view.magnified === 1) return "y (mm)";
  const long = `y (mm), drawn ${view.magnified}× as large as x`;
  return measure(long, "small") < room ? long : `y (mm), drawn ${view.magnified}×`;
}
