/** The picture, drawn anew in the next frame after something has changed. */

import { getContext, onScheme, part } from "./dom.js";
import { paintAxes, paintTissue } from "./painters/background.js";
import * as needle from "./painters/needle.js";
import * as overlay from "./painters/overlay.js";
import { avoid, clearLabels, palette, placesOf, readPalette, within } from "./painters/strokes.js";
import { listen, now, publish, redraw } from "./store.js";
import { follow, resize } from "./view.js";

const picture = part("picture");
const canvas = part("canvas");
const screen = getContext(canvas);
let frame = 0;

/** Width and height of the picture, px. */
export const size = () => [picture.clientWidth, picture.clientHeight];

/** Draw the picture in a context of a size, px. */
export function paint(context, figure) {
  const { state, shown, scene, band: newest } = now;
  // while a needle moves faster than draws are computed, their band is of a place that it has left
  const band = shown.band && newest && overlay.isBandNear(newest, state) ? newest : null;
  const measured = shown.measured ? scene.measured : null;
  context.fillStyle = palette.gutter;
  context.fillRect(0, 0, ...figure);
  clearLabels();
  needle.reserveNeedle(state);
  if (measured) avoid(placesOf(measured.x, measured.y));
  context.lineJoin = "round";
  within(context, now.view.box, () => {
    paintTissue(context);
    if (band) overlay.paintBand(context, band, band.step !== state.step);
    if (shown.plan && scene.plan) overlay.paintPlan(context, scene.plan);
    needle.paintNeedle(context, state);
    overlay.paintPrediction(context, state);
    if (measured) overlay.paintMeasured(context, measured);
    if (measured && shown.errors) overlay.paintGaps(context, state, measured);
    needle.paintGuides(context, state);
    needle.paintBase(context, state);
    if (measured) overlay.nameNeedle(context, state);
    if (band) overlay.nameBand(context, band);
  });
  paintAxes(context);
}

/** Give the canvas as many pixels as the screen has for it. */
function measure() {
  const [width, height] = size();
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  screen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  resize(width, height);
  redraw();
}

listen("redraw", () => {
  frame ||= requestAnimationFrame(() => {
    frame = 0;
    if (now.state) {
      paint(screen, size());
      document.body.classList.add("begun");
    }
    publish("drawn");
  });
});
listen("state", () => (follow(), redraw()));
listen("band", redraw);
new ResizeObserver(measure).observe(picture);
onScheme(() => (readPalette(), redraw()));
readPalette();
