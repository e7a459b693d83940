/** The picture: a background, drawn when the view or the tissue changes, and a foreground of every frame. */

import { onScheme, part } from "./dom.js";
import { paintAxes, paintTissue } from "./painters/background.js";
import * as needle from "./painters/needle.js";
import * as overlay from "./painters/overlay.js";
import { clearBoxes, palette, readPalette } from "./painters/strokes.js";
import { listen, now, publish } from "./store.js";
import { fit, follow, resize, takeChange, touch, view } from "./view.js";

const picture = part("picture");
const background = part("background");
const foreground = part("canvas");
const behind = background.getContext("2d", { alpha: false });
const before = foreground.getContext("2d");

/** Which parts are drawn; what there is none of is not, whatever stands here. */
export const shown = { load: true, points: true, path: true, measured: true, band: true, errors: true, plan: true, pinned: true, strip: true };

/** What else is drawn over the needle: functions of the context. */
export const further = [];

let drawnTissue = "";
let stale = true; // whether the foreground must be drawn though no state has come

/** Draw again in the next frame. */
export function invalidate() {
  stale = true;
  publish("redraw");
}

let [frame, fresh] = [0, false];

/** Draw in the next frame; `drawn` is published then. */
function redraw() {
  frame ||= requestAnimationFrame(() => {
    frame = 0;
    paint();
    fresh = false;
    publish("drawn");
  });
}

function paint() {
  if (!now.scene || !now.state) return;
  if (fresh) follow();
  paintScreen();
  document.body.classList.add("begun");
}

/** Draw what has changed. */
export function paintScreen() {
  const moved = takeChange();
  const tissue = JSON.stringify(now.state.layers);
  if (moved || tissue !== drawnTissue) paintBackground(behind, size());
  drawnTissue = tissue;
  if (moved || fresh || stale) {
    before.clearRect(0, 0, ...size());
    paintForeground(before, now.state);
  }
  stale = false;
}

/** Draw the picture in a context of a size, px. */
export function paintAll(context, figure) {
  paintBackground(context, figure);
  paintForeground(context, now.state);
}

let measured = [1, 1];

/** Width and height of the picture, px. */
export const size = () => measured;

function paintBackground(context, figure) {
  context.fillStyle = palette.gutter;
  context.fillRect(0, 0, ...figure);
  within(context, () => paintTissue(context));
  paintAxes(context);
}

function paintForeground(context, state) {
  // while a needle moves faster than draws are computed, their band is of a place that it has left
  const band = shown.band && now.band && overlay.isBandNear(now.band, state) ? now.band : null;
  clearBoxes();
  needle.reserveNeedle(state);
  context.lineJoin = "round";
  within(context, () => {
    const loaded = shown.load && !state.faults.length; // outside the model's limits a force means nothing
    if (loaded) needle.paintLoad(context, state);
    if (band) overlay.paintBand(context, band, band.step !== state.step);
    if (shown.plan && now.scene.plan) overlay.paintPlan(context, now.scene.plan);
    if (shown.pinned && now.pinned) overlay.paintPinned(context, now.pinned);
    needle.paintNeedle(context, state);
    overlay.paintInset(context, state);
    needle.paintTip(context, state);
    if (loaded) needle.paintTipForce(context, state);
    if (shown.path) needle.paintPath(context, state);
    if (shown.points) needle.paintPoints(context, state);
    overlay.paintPrediction(context, state);
    if (shown.measured && now.scene.measured) {
      overlay.paintMeasured(context, now.scene.measured);
      if (shown.errors) overlay.paintGaps(context, state, now.scene.measured);
    }
    for (const draw of further) draw(context);
    needle.paintGuides(context, state);
    needle.paintBase(context, state);
    if ((shown.measured && now.scene.measured) || (shown.pinned && now.pinned)) overlay.nameNeedle(context, state);
    if (band) overlay.nameBand(context, band);
    if (now.marked != null) needle.paintMark(context, state, now.marked);
  });
  if (shown.load && !state.faults.length) needle.paintKey(context);
}

function within(context, draw) {
  const { left, top, width, height } = view.box;
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  draw();
  context.restore();
}

/** Give both canvases as many pixels as the screen has for them. */
function measure() {
  const [width, height] = (measured = [picture.clientWidth, picture.clientHeight]);
  for (const [canvas, context] of [[background, behind], [foreground, before]]) {
    canvas.width = Math.round(width * devicePixelRatio);
    canvas.height = Math.round(height * devicePixelRatio);
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  }
  resize(width, height);
}

new ResizeObserver(measure).observe(picture);
onScheme(() => (readPalette(), touch()));
readPalette();
for (const kind of ["band", "forces"]) listen(kind, invalidate);
let fitted = null;
listen("state", () => {
  fresh = true;
  redraw();
  if (fitted === now.scene) return;
  fitted = now.scene;
  fit(view.fit ?? "tissue");
});
listen("redraw", redraw);
