/** The picture as a figure: the same painters draw what the page shows, in a width of print. */

import { hand, part, press, usePaper, write } from "./dom.js";
import { invalidate, paintAll, paintScreen, size } from "./drawing.js";
import { nameOf } from "./link.js";
import { readPalette } from "./painters/strokes.js";
import { inWords } from "./readouts.js";
import { now } from "./store.js";
import { SvgContext } from "./svg.js";
import { touch, view } from "./view.js";

const PX_PER_MM = 96 / 25.4;
const DPI = 300; // of a PNG

/** Draw on paper, in a width in mm, between the limits of the picture; `begin(size)` gives the context for a size in px. */
function draw(wide, begin) {
  const { box, scale } = view;
  const [whole, tall] = size();
  const width = wide * PX_PER_MM;
  const share = (width - (whole - box.width)) / box.width;
  /** @type {[number, number]} */
  const figure = [width, tall - box.height + share * box.height];
  Object.assign(view, { scale: scale * share, box: { ...box, width: share * box.width, height: share * box.height } });
  onPaper(true);
  try {
    paintAll(begin(figure), figure);
  } finally {
    Object.assign(view, { scale, box });
    onPaper(false);
  }
  return figure;
}

/** Draw in the light colours, or in those of the reader again. */
function onPaper(on) {
  usePaper(on);
  readPalette();
}

function drawSvg(wide) {
  const context = new SvgContext();
  const figure = draw(wide, () => context);
  return new Blob([context.write(figure, wide, now.scene.title, inWords())], { type: "image/svg+xml" });
}

function drawPng(wide) {
  const canvas = document.createElement("canvas");
  draw(wide, (figure) => {
    const times = DPI / 96;
    Object.assign(canvas, { width: Math.round(times * figure[0]), height: Math.round(times * figure[1]) });
    const context = canvas.getContext("2d");
    context.scale(times, times);
    return context;
  });
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

press("save-figure", async () => {
  if (!now.state) return;
  const format = part("figure-format").value;
  const figure = await (format === "svg" ? drawSvg : drawPng)(Number(part("figure-width").value));
  const name = `${nameOf(now.needle).replace(/[^\w-]+/g, "-")}.${format}`;
  hand(figure, name);
  write("link-note", `Saved ${name}: the picture as it is shown.`);
  invalidate();
});

for (const [kind, on] of /** @type {[string, boolean][]} */ ([["beforeprint", true], ["afterprint", false]])) {
  addEventListener(kind, () => {
    onPaper(on);
    touch();
    if (now.state) paintScreen();
  });
}
