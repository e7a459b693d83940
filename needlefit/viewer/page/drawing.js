/** The picture and the view from above, drawn anew in the next frame after something has changed, and moved by the pointer. */

import { getContext, onScheme, part } from "./dom.js";
import { isSpatial, paintAbove, paintPicture } from "./painters/picture.js";
import { readPalette } from "./painters/strokes.js";
import { Screen } from "./sheet.js";
import { listen, now, publish, redraw } from "./store.js";
import { fit, follow, pan, resize, zoom } from "./view.js";

const NOTCHES = [300, 10, 2]; // wheel units that halve the scale, by deltaMode
/** @type {HTMLCanvasElement} */
const canvas = part("canvas");
let frame = 0;

/** Width and height of the picture, px. @returns {Point} */
export const size = () => [canvas.clientWidth, canvas.clientHeight];

/** A sheet on a canvas, which gets as many pixels as the screen has for it. @param {HTMLCanvasElement} on */
function makeSheet(on) {
  const [width, height] = [on.clientWidth, on.clientHeight].map((one) => Math.round(one * devicePixelRatio));
  if (on.width !== width || on.height !== height) Object.assign(on, { width, height });
  const context = getContext(on);
  context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  return new Screen(context);
}

/** Draw at once, as before the page is printed. */
export function draw() {
  frame = 0;
  if (now.state) {
    const above = part("above");
    above.hidden = !isSpatial();
    if (!above.hidden) paintAbove(makeSheet(above), [above.clientWidth, above.clientHeight]);
    paintPicture(makeSheet(canvas), size());
    document.body.classList.add("begun");
  }
  publish("drawn");
}

listen("redraw", () => (frame ||= requestAnimationFrame(draw)));
listen("state", () => (follow(), redraw()));
listen("band", redraw);
new ResizeObserver(() => resize(...size())).observe(part("picture"));
new ResizeObserver(redraw).observe(part("above"));
onScheme(() => (readPalette(), redraw()));
readPalette();

// A mouse shifts what is seen, its wheel zooms once the picture has the focus: before, both are the page's.
let last = [0, 0]; // where the pointer was, px
canvas.addEventListener("pointerdown", ({ pointerId }) => canvas.setPointerCapture(pointerId));
canvas.addEventListener("pointermove", ({ buttons, pointerType, offsetX, offsetY }) => {
  if (buttons === 1 && pointerType !== "touch") pan(offsetX - last[0], offsetY - last[1]);
  last = [offsetX, offsetY];
});
canvas.addEventListener("wheel", (event) => {
  if (document.activeElement !== canvas && !event.ctrlKey) return;
  event.preventDefault();
  zoom(2 ** (-event.deltaY / NOTCHES[event.deltaMode]), [event.offsetX, event.offsetY]);
}, { passive: false });
canvas.addEventListener("dblclick", () => fit("tissue"));
