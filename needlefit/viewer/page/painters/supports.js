/** What holds the needle: the base on its stage, and guides as clamps. */

import { guidePlace, basePlace } from "../handles.js";
import { shortName } from "../names.js";
import { palette } from "../palette.js";
import { toPx, toPy, view } from "../view.js";
import { thickness } from "./needle.js";
import { label, ring, straight, turned } from "./strokes.js";

const HANDLE = 7; // px
const LINE = 15; // px, the height of a name

/** Draw the hub, the rail along which the stage moves it, and the ring that turns it. */
export function paintBase(context, state) {
  const { place: [px, py], turn, angle } = basePlace(state);
  const half = Math.max(thickness() / 2 + 4, 7);
  straight(context, [px, py - 46], [px, py + 46], palette.quiet, 2);
  for (const to of [-1, 1]) arrowHead(context, px, py + 46 * to, to);
  straight(context, [px, py], turn, palette.ink, 1.5);
  turned(context, px, py, angle, () => {
    context.fillStyle = palette.ink;
    context.beginPath();
    context.roundRect(-22, -half, 26, 2 * half, 4);
    context.fill();
  });
  ring(context, ...turn, HANDLE, palette.ink, palette.air);
}

function arrowHead(context, px, py, to) {
  context.fillStyle = palette.quiet;
  context.beginPath();
  context.moveTo(px - 5, py);
  context.lineTo(px, py + 7 * to);
  context.lineTo(px + 5, py);
  context.fill();
}

/** Draw each guide: two jaws along its direction if it clamps, two points if the needle turns in it. */
export function paintGuides(context, state) {
  for (const guide of state.guides) {
    const { place, turn, angle } = guidePlace(guide);
    const gap = thickness() / 2 + 2;
    if (!guide.turns_freely) straight(context, place, turn, palette.guide, 1.5);
    turned(context, ...place, angle, () => {
      context.fillStyle = palette.guide;
      for (const to of [-1, 1]) (guide.turns_freely ? point : jaw)(context, gap * to, to);
    });
    if (!guide.turns_freely) ring(context, ...turn, HANDLE, palette.guide, palette.air);
  }
  writeNames(context, state.guides);
}

/** Under each guide its number, or the name that its scene gives it; of two that would overlap, the first. */
function writeNames(context, guides) {
  context.font = "600 12px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  const written = [];
  for (const guide of guides.toSorted((one, other) => one.item - other.item)) {
    const [px, py] = [toPx(guide.x), toPy(guide.y) + thickness() / 2 + 26];
    if (px < view.box.left || px > view.box.left + view.box.width) continue; // out of the picture
    const name = shortName(guide);
    const half = context.measureText(name).width / 2 + 3;
    const overlaps = (one) => Math.abs(one.px - px) < one.half + half && Math.abs(one.py - py) < LINE;
    if (written.some(overlaps)) continue;
    written.push({ px, py, half });
    label(context, name, px, py, palette.guide);
  }
}

function jaw(context, from, to) {
  context.beginPath();
  context.roundRect(-13, Math.min(from, from + 7 * to), 26, 7, 2);
  context.fill();
}

function point(context, from, to) {
  context.beginPath();
  context.moveTo(0, from);
  context.lineTo(-7, from + 11 * to);
  context.lineTo(7, from + 11 * to);
  context.fill();
}
