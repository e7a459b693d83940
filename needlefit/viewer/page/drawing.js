/** The picture: a background, drawn when the view or the tissue changes, and a foreground of every frame. */

import { paintAxes } from "./painters/axes.js";
import { paintGoal, paintPlan, paintReach } from "./painters/aim.js";
import { paintBase, paintGuides } from "./painters/supports.js";
import { paintHint } from "./painters/hint.js";
import { paintLoad } from "./painters/load.js";
import { paintNeedle, paintPath, paintPoints, paintTip } from "./painters/needle.js";
import { paintBand, paintGaps, paintMeasured, paintPoints as paintMeasuredPoints } from "./painters/overlay.js";
import { paintTissue } from "./painters/tissue.js";
import { paintTrackedTip } from "./painters/tracked_tip.js";
import { palette, readPalette } from "./palette.js";
import { slice } from "./slice.js";
import { listen, now, publish } from "./store.js";
import { paintArrow, paintInset } from "./painters/inset.js";
import { fit, follow, resize, seesTip, takeChange, touch, view } from "./view.js";

const picture = document.getElementById("picture");
const background = document.getElementById("background");
const foreground = document.getElementById("canvas");
const behind = background.getContext("2d", { alpha: false });
const before = foreground.getContext("2d");

/** Which parts are drawn; what there is none of is not, whatever stands here. */
export const shown = { load: true, points: true, path: true, measured: true, band: true, raw: false, errors: true, slice: true, plan: true, reach: true };

let drawnTissue = "";
let stale = true; // whether the foreground must be drawn though no state has come

/** Draw again in the next frame. */
export function invalidate() {
  stale = true;
  publish("redraw");
}

/** Draw what has changed. */
export function paint(fresh) {
  if (!now.scene || !now.state) return;
  if (fresh) follow();
  const moved = takeChange();
  const tissue = JSON.stringify(now.state.layers);
  if (moved || tissue !== drawnTissue) paintBackground();
  drawnTissue = tissue;
  if (moved || fresh || stale) paintForeground(now.state);
  stale = false;
  document.body.classList.add("begun");
}

function paintBackground() {
  behind.fillStyle = palette.gutter;
  behind.fillRect(0, 0, picture.clientWidth, picture.clientHeight);
  within(behind, () => paintTissue(behind, shown.slice ? slice() : null));
  paintAxes(behind);
}

function paintForeground(state) {
  before.clearRect(0, 0, picture.clientWidth, picture.clientHeight);
  within(before, () => {
    if (shown.reach) paintReach(before);
    paintGoal(before);
    if (shown.plan) paintPlan(before);
    paintNeedle(before, state);
    if (shown.band && now.band) paintBand(before, now.band, now.band.step !== state.step);
    if (shown.load) paintLoad(before, state, shown.raw);
    paintTip(before, state);
    if (shown.path) paintPath(before, state);
    if (shown.points) paintPoints(before, state);
    if (shown.measured && now.scene.measured) {
      paintMeasured(before, now.scene.measured);
      paintMeasuredPoints(before);
      if (shown.errors) paintGaps(before, state, now.scene.measured);
    }
    paintGuides(before, state);
    paintBase(before, state);
    paintTrackedTip(before);
    paintHint(before, state);
    if (view.magnified > 1) paintInset(before, state);
    if (!seesTip()) paintArrow(before, state);
  });
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
  const [width, height] = [picture.clientWidth, picture.clientHeight];
  for (const [canvas, context] of [[background, behind], [foreground, before]]) {
    canvas.width = Math.round(width * devicePixelRatio);
    canvas.height = Math.round(height * devicePixelRatio);
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  }
  resize(width, height);
}

function recolour() {
  readPalette();
  touch();
}

new ResizeObserver(measure).observe(picture);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
recolour();
listen("band", invalidate);
listen("aimed", invalidate);
listen("tracking", invalidate);
listen("slice", touch);
let fitted = null;
listen("state", () => {
  if (fitted === now.scene.target) return;
  fitted = now.scene.target;
  fit(view.fit ?? "tissue");
});
