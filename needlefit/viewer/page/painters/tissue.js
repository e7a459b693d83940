/** What stands still: air, layers, the scan's slice, skin and the undeformed axis. */

import { asMpa } from "../numbers.js";
import { palette, shades } from "../palette.js";
import { now } from "../store.js";
import { toPx, toPy, view } from "../view.js";
import { label } from "./strokes.js";

const FONT = "12px system-ui, sans-serif";
const APART = 14; // px between a name and its layer's edges
const LOW = 160; // px; in a lower window μ would lie on the needle

/** Draw the layers, over the slice where there is one. */
export function paintTissue(context, slice) {
  const { left, top, width, height } = view.box;
  context.fillStyle = palette.air;
  context.fillRect(left, top, width, height);
  const layers = seenLayers();
  for (const { from, to, shade } of layers) {
    context.fillStyle = shade;
    context.fillRect(from, top, to - from, height);
  }
  if (slice) paintSlice(context, slice);
  paintEdges(context, layers);
  paintNames(context, layers);
}

/** The layers that are in the window: their edges (px), shades and numbers. */
function seenLayers() {
  const { boundaries_mm: tops, layer_names: names } = now.scene;
  const { left, width } = view.box;
  const depths = [0, ...tops, Infinity];
  const colours = shades(now.state.layers);
  return colours
    .map((shade, i) => ({
      shade, number: i + 1, name: names[i] || `layer ${i + 1}`, mu: now.state.layers[i].mu_pa,
      top: toPx(depths[i]),
      from: Math.max(toPx(depths[i]), left), to: Math.min(toPx(depths[i + 1]), left + width),
    }))
    .filter(({ from, to }) => to > from);
}

function paintSlice(context, { image, extent }) {
  const [x0, x1, y0, y1] = extent;
  context.globalAlpha = 0.85;
  context.drawImage(image, toPx(x0), toPy(y1), toPx(x1) - toPx(x0), toPy(y0) - toPy(y1));
  context.globalAlpha = 1;
}

function paintEdges(context, layers) {
  const { left, top, width, height } = view.box;
  for (const { from, number, top: edge } of layers) {
    if (edge < left) continue; // its upper side lies outside
    context.fillStyle = number === 1 ? palette.ink : palette.edge;
    context.fillRect(Math.round(from) - 0.5, top, number === 1 ? 1.5 : 1, height);
  }
  context.strokeStyle = palette.quiet;
  context.lineWidth = 1;
  context.setLineDash([5, 4]);
  context.beginPath();
  context.moveTo(left, Math.round(toPy(0)) + 0.5);
  context.lineTo(left + width, Math.round(toPy(0)) + 0.5);
  context.stroke();
  context.setLineDash([]);
}

/** All layers are called in the same way: by their names if these fit, or by their numbers. */
function paintNames(context, layers) {
  const { left, top, height } = view.box;
  context.font = FONT;
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  const fits = (text, layer) => context.measureText(text).width + APART < layer.to - layer.from;
  const named = layers.every((layer) => fits(layer.name, layer));
  for (const layer of layers) {
    const middle = (layer.from + layer.to) / 2;
    label(context, named ? layer.name : String(layer.number), middle, top + 18);
    const mu = `μ ${asMpa(layer.mu)} MPa`;
    if (height >= LOW && fits(mu, layer)) label(context, mu, middle, top + 34);
  }
  const skin = toPx(0);
  if (skin > left + 40) turnedLabel(context, "skin", skin - 6, top + height - 10);
}

function turnedLabel(context, text, px, py) {
  context.save();
  context.translate(px, py);
  context.rotate(-Math.PI / 2);
  context.textAlign = "left";
  label(context, text, 0, 0);
  context.restore();
}
