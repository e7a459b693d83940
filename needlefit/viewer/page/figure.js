/** The picture as a figure: the same painters draw what the page shows, in a width of print. */

import { isSpatial, paintAbove } from "./above.js";
import { getContext, hand, part, press, usePaper, write } from "./dom.js";
import { paint, size } from "./drawing.js";
import { FigureContext, writeSvg } from "./figure_context.js";
import { nameOf } from "./link.js";
import { readPalette } from "./painters/strokes.js";
import { inWords } from "./readouts.js";
import { now, redraw } from "./store.js";
import { view } from "./view.js";

const PX_PER_MM = 96 / 25.4;
const DPI = 300; // of a PNG

/** Draw on paper, in a width in mm, between the limits of the picture; `begin(size)` gives the context for a size in px. */
function draw(wide, begin) {
  const kept = { ...view };
  const [across, tall] = size();
  onPaper(true);
  try {
    const { box, scale } = view;
    const width = wide * PX_PER_MM;
    const share = (width - (across - box.width)) / box.width;
    /** @type {[number, number]} */
    const figure = [width, tall - box.height + share * box.height];
    const above = isSpatial() ? part("above").clientHeight : 0;
    /** @type {[number, number]} */
    const all = [width, figure[1] + above];
    Object.assign(view, { scale: scale * share, box: { ...box, width: share * box.width, height: share * box.height } });
    const context = begin(all);
    paint(context, figure);
    context.translate(0, figure[1]);
    if (above) paintAbove(context, width, above);
    return all;
  } finally {
    Object.assign(view, kept);
    onPaper(false);
    redraw();
  }
}

/** Draw in the light colours, or in those of the reader again. */
function onPaper(on) {
  usePaper(on);
  readPalette();
}

function drawPng(wide) {
  const canvas = document.createElement("canvas");
  draw(wide, (figure) => {
    const times = DPI / 96;
    Object.assign(canvas, { width: Math.round(times * figure[0]), height: Math.round(times * figure[1]) });
    const context = getContext(canvas);
    context.scale(times, times);
    return context;
  });
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

function drawSvg(wide) {
  const context = new FigureContext();
  const figure = draw(wide, () => context);
  return new Blob([writeSvg(context.drawn, figure, wide, now.scene.title, inWords())], { type: "image/svg+xml" });
}

press("save-figure", async () => {
  if (!now.state) return;
  const [format, wide] = [part("figure-format").value, Number(part("figure-width").value)];
  const figure = await (format === "png" ? drawPng(wide) : drawSvg(wide));
  const name = `${nameOf(now.needle).replace(/[^\w-]+/g, "-")}.${format}`;
  hand(figure, name);
  write("link-note", `Saved ${name}: the picture as it is shown.`);
});

for (const [kind, on] of /** @type {[string, boolean][]} */ ([["beforeprint", true], ["afterprint", false]])) {
  addEventListener(kind, () => {
    onPaper(on);
    if (now.state) paint(getContext(part("canvas")), size()); // the page is printed before another frame
  });
}
