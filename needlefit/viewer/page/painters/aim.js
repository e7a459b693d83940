/** The target with its radius, obstacles, the region that the tip can reach, and the needles of a plan. */

import { aim, nameOf } from "../aim.js";
import { palette } from "../palette.js";
import { toPx, toPy, view } from "../view.js";
import { label, line } from "./strokes.js";

const FAN = 0.3; // opacity of the plan's draws
const PALE = 0.35; // of a plan that the needle has left
const CROSS = 5; // px

/** Shade where the tip can come to stand: the more of the draws, the stronger. */
export function paintReach(context) {
  if (!aim.reach) return;
  const { x, low, high } = aim.reach;
  context.fillStyle = palette.reach;
  low.forEach((lowest, level) => {
    context.beginPath();
    x.forEach((one, i) => context.lineTo(toPx(one), toPy(lowest[i])));
    for (let i = x.length - 1; i >= 0; i -= 1) context.lineTo(toPx(x[i]), toPy(high[level][i]));
    context.closePath();
    context.globalAlpha = 0.12;
    context.fill();
  });
  context.globalAlpha = 1;
}

/** Draw the needles of the draws, and over them the one of the parameters shown; in a challenge nothing. */
export function paintPlan(context) {
  if (!aim.plan || aim.challenge?.hidden) return;
  const pale = aim.plan.left ? PALE : 1;
  context.globalAlpha = FAN * pale;
  for (const [x, y] of aim.plan.fan) line(context, x, y, palette.plan, 1);
  context.globalAlpha = pale;
  line(context, aim.plan.x, aim.plan.y, palette.halo, 4);
  line(context, aim.plan.x, aim.plan.y, palette.plan, 2, [10, 4]);
  context.globalAlpha = 1;
}

/** Draw target and obstacles. */
export function paintGoal(context) {
  aim.obstacles.forEach(([x, y, radius], i) => {
    ellipse(context, x, y, radius);
    context.globalAlpha = 0.28;
    context.fillStyle = palette.tip;
    context.fill();
    context.globalAlpha = 1;
    outline(context, palette.tip, 2);
    text(context, x, y + radius, nameOf(i), palette.tip, -9);
  });
  if (!aim.target) return;
  const [x, y] = aim.target;
  ellipse(context, x, y, aim.radius);
  outline(context, palette.guide, 2);
  context.beginPath();
  const [px, py] = [toPx(x), toPy(y)];
  for (const [dx, dy] of [[CROSS, 0], [0, CROSS]]) {
    context.moveTo(px - dx, py - dy);
    context.lineTo(px + dx, py + dy);
  }
  context.stroke();
  text(context, x, y + aim.radius, "target", palette.guide, -9);
}

function ellipse(context, x, y, radius) {
  context.beginPath();
  context.ellipse(toPx(x), toPy(y), radius * view.scale, radius * view.scale * view.magnified, 0, 0, 2 * Math.PI);
}

function outline(context, colour, width) {
  context.strokeStyle = palette.halo;
  context.lineWidth = width + 2;
  context.stroke();
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}

function text(context, x, y, words, colour, up = 0) {
  context.font = "600 12px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  label(context, words, toPx(x), toPy(y) + up, colour);
}
