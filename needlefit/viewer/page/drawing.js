/** The picture and the view from above, drawn anew in the next frame after something has changed, and moved by the pointer. */

import { part } from "./dom.js";
import { isSpatial, paintAbove, paintPicture } from "./painters/picture.js";
import { drawOn } from "./sheet.js";
import { listen, now, publish, redraw } from "./store.js";
import { fit, follow, pan, resize, zoom } from "./view.js";

const NOTCHES = [300, 10, 2]; // wheel units that halve the scale, by deltaMode
/** @type {SVGSVGElement} */
const picture = part("picture");
let frame = 0;

/** Width and height of a part, px. @param {Element} shown @returns {Point} */
export const sizeOf = ({ clientWidth, clientHeight }) => [clientWidth, clientHeight];

function draw() {
  frame = 0;
  if (now.state) {
    const above = part("above");
    above.toggleAttribute("hidden", !isSpatial());
    if (isSpatial()) drawOn(above, sizeOf(above), () => paintAbove(sizeOf(above)));
    drawOn(picture, sizeOf(picture), () => paintPicture(sizeOf(picture)));
  }
  publish("drawn");
}

listen("redraw", () => (frame ||= requestAnimationFrame(draw)));
listen("state", () => (follow(), redraw()));
listen("band", redraw);
new ResizeObserver(() => resize(...sizeOf(picture))).observe(picture);
new ResizeObserver(redraw).observe(part("above"));

// A mouse shifts what is seen, its wheel zooms once the picture has the focus: before, both are the page's.
let last = [0, 0]; // where the pointer was, px
picture.addEventListener("pointerdown", ({ pointerId }) => picture.setPointerCapture(pointerId));
picture.addEventListener("pointermove", ({ buttons, pointerType, offsetX, offsetY }) => {
  if (buttons === 1 && pointerType !== "touch") pan(offsetX - last[0], offsetY - last[1]);
  last = [offsetX, offsetY];
});
picture.addEventListener("wheel", (event) => {
  if (document.activeElement !== picture && !event.ctrlKey) return;
  event.preventDefault();
  zoom(2 ** (-event.deltaY / NOTCHES[event.deltaMode]), [event.offsetX, event.offsetY]);
}, { passive: false });
picture.addEventListener("dblclick", () => fit("tissue"));
