/** The picture as a figure: the same painters draw what the page shows, in a width of print. */

import { getContext, hand, part, press, write } from "./dom.js";
import { draw, size } from "./drawing.js";
import { nameOf } from "./link.js";
import { isSpatial, paintAbove, paintPicture } from "./painters/picture.js";
import { readPalette } from "./painters/strokes.js";
import { inWords } from "./readouts.js";
import { Figure, Screen } from "./sheet.js";
import { now, redraw } from "./store.js";
import { look, view } from "./view.js";

const PX_PER_MM = 96 / 25.4;
const DPI = 300; // of a PNG

/** Draw on paper, in a width in mm, between the limits of the picture; `begin(size)` gives the sheet for a size in px. @template {Sheet} T @param {number} wide @param {(size: Point) => T} begin */
function drawFigure(wide, begin) {
  const [across, tall] = size();
  const { box, scale } = view;
  const width = wide * PX_PER_MM;
  const share = (width - (across - box.width)) / box.width;
  const height = tall - box.height + share * box.height;
  const above = isSpatial() ? part("above").clientHeight : 0;
  const sheet = begin([width, height + above]);
  readPalette(true);
  look({ scale: scale * share, box: { ...box, width: share * box.width, height: share * box.height } }, () => {
    if (above) sheet.turned([0, height], 0, () => paintAbove(sheet, [width, above]));
    paintPicture(sheet, [width, height]);
  });
  readPalette();
  redraw();
  return sheet;
}

/** @param {number} wide @returns {Promise<Blob | null>} */
function drawPng(wide) {
  const canvas = document.createElement("canvas");
  const times = DPI / 96;
  drawFigure(wide, ([width, height]) => {
    Object.assign(canvas, { width: Math.round(times * width), height: Math.round(times * height) });
    const context = getContext(canvas);
    context.scale(times, times);
    return new Screen(context);
  });
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

/** @param {number} wide */
function drawSvg(wide) {
  const { svg } = drawFigure(wide, (figure) => new Figure(figure, wide, now.scene.title, inWords()));
  return new Blob([new XMLSerializer().serializeToString(svg)], { type: "image/svg+xml" });
}

press("save-figure", async () => {
  if (!now.state) return;
  const [format, wide] = [part("figure-format").value, Number(part("figure-width").value)];
  const figure = await (format === "png" ? drawPng(wide) : drawSvg(wide));
  const name = `${nameOf(now.needle).replace(/[^\w-]+/g, "-")}.${format}`;
  if (!figure) return;
  hand(figure, name);
  write("link-note", `Saved ${name}: the picture as it is shown.`);
});

for (const [kind, on] of /** @type {[string, boolean][]} */ ([["beforeprint", true], ["afterprint", false]])) {
  addEventListener(kind, () => {
    readPalette(on);
    draw(); // the page is printed before another frame
  });
}
