/** The tip where a tracker has it. */

import { palette } from "../palette.js";
import { listen } from "../store.js";
import { toPx, toPy } from "../view.js";

const ARM = 9; // px of the cross
let tracked = null;

/** Draw where the tracker has the tip: a cross, grey while it is frozen. */
export function paintTrackedTip(context) {
  if (!tracked?.tip) return;
  const [x, y] = [toPx(tracked.tip[0]), toPy(tracked.tip[1])];
  for (const [colour, width] of [[palette.halo, 5], [tracked.frozen ? palette.quiet : palette.measured, 2]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    for (const [dx, dy] of [[ARM, ARM], [ARM, -ARM]]) {
      context.moveTo(x - dx, y - dy);
      context.lineTo(x + dx, y + dy);
    }
    context.stroke();
  }
}

listen("tracking", (message) => (tracked = message));
