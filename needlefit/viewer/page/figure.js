/** The picture as a figure: the same painters draw what the page shows, in a width of print. */

import { element, part, press, write } from "./dom.js";
import { sizeOf } from "./drawing.js";
import { save } from "./link.js";
import { isSpatial, paintAbove, paintPicture } from "./painters/picture.js";
import { inWords } from "./readouts.js";
import { turned, writeFigure } from "./sheet.js";
import { now, redraw } from "./store.js";
import { look, view } from "./view.js";

const PX_PER_MM = 96 / 25.4;
const DPI = 300; // of a PNG

/** Draw for print, in a width in mm, between the limits of the picture and in the light colours. @param {number} wide */
function drawFigure(wide) {
  const [across, tall] = sizeOf(part("picture"));
  const { box, scale } = view;
  const width = wide * PX_PER_MM;
  const share = (width - (across - box.width)) / box.width;
  const height = tall - box.height + share * box.height;
  const above = isSpatial() ? part("above").clientHeight : 0;
  const style = getComputedStyle(document.documentElement);
  /** @param {string} name */
  const readLight = (name) => style.getPropertyValue(`--${name}`).match(/#\w+/)?.[0] ?? "";
  return look({ scale: scale * share, box: { ...box, width: share * box.width, height: share * box.height } }, () =>
    writeFigure([width, height + above], wide, [now.scene.title, inWords()], readLight, () => {
      if (above) turned([0, height], 0, () => paintAbove([width, above]));
      paintPicture([width, height]);
    }));
}

/** An SVG as a PNG of a width in mm. @param {string} svg @param {number} wide @returns {Promise<Blob>} */
async function rasterize(svg, wide) {
  const image = /** @type {HTMLImageElement} */ (element("img", { src: `data:image/svg+xml,${encodeURIComponent(svg)}` }));
  await image.decode();
  const width = Math.round((wide / 25.4) * DPI);
  const height = Math.round((width * image.height) / image.width);
  const canvas = /** @type {HTMLCanvasElement} */ (element("canvas", { width, height }));
  canvas.getContext("2d")?.drawImage(image, 0, 0, width, height);
  return new Promise((resolve) => canvas.toBlob((blob) => resolve(blob ?? new Blob()), "image/png"));
}

press("save-figure", async () => {
  if (!now.state) return;
  const [format, wide] = [part("figure-format").value, Number(part("figure-width").value)];
  const svg = drawFigure(wide);
  redraw(); // labels are again those of the page
  const name = format === "png" ? save(await rasterize(svg, wide), "image/png", format) : save(svg, "image/svg+xml", format);
  write("link-note", `Saved ${name}: the picture as it is shown.`);
});
