/** A ring about the handle that the tour asks to drag, and the ways it can go. */

import { basePlace, bevelPlace } from "../handles.js";
import { palette } from "../palette.js";
import { now } from "../store.js";
import { ring, turned } from "./strokes.js";

const [RADIUS, HEAD] = [22, 8]; // px
const UP = Math.PI / 2;

/** Draw it about what `now.hint` names: the arrow of the bevel, or the base moved across or along. */
export function paintHint(context, state) {
  if (!now.hint) return;
  const place = now.hint === "bevel" ? bevelPlace(state).turn : basePlace(state).place;
  const ways = { bevel: [-state.bevel.side * UP], across: [UP, -UP], along: [0] }[now.hint];
  ring(context, ...place, RADIUS, palette.accent, "transparent");
  for (const way of ways) turned(context, ...place, way, () => arrowHead(context));
}

function arrowHead(context) {
  context.fillStyle = palette.accent;
  context.beginPath();
  context.moveTo(RADIUS + 3, -HEAD);
  context.lineTo(RADIUS + 3 + 1.4 * HEAD, 0);
  context.lineTo(RADIUS + 3, HEAD);
  context.fill();
}
