/** The view from above, below that from the side: x as there, z upwards, drawn at most as large as y. Shown of a needle in space. */

import { getContext, onScheme, part } from "./dom.js";
import { paintFrame, paintTissue } from "./painters/background.js";
import { paintNeedle } from "./painters/needle.js";
import { isBandNear, paintBand, paintMeasured } from "./painters/overlay.js";
import { clearLabels, label, palette, setFont, within } from "./painters/strokes.js";
import { brief } from "./quantities.js";
import { listen, now } from "./store.js";
import { view } from "./view.js";

const [EDGE, ROOM] = [8, 14]; // px above and below the window, and in it
const canvas = part("above");
const screen = getContext(canvas);

/** Whether something is seen from above: a needle in space, or one that is compared there. */
export const isSpatial = () => Boolean(now.state?.z ?? now.scene?.measured?.compared === "space");

/** The needle as it is seen from above: z in place of y. */
function turn(state) {
  const roll = (state.bevel.roll_deg * Math.PI) / 180;
  return { ...state, y: state.z, bevel: { side: Math.sin(roll) < 0 ? -1 : 1 } };
}

function draw() {
  canvas.hidden = !now.state || !isSpatial();
  if (canvas.hidden) return;
  const { clientWidth: width, clientHeight: height } = canvas;
  const size = [width, height].map((one) => Math.round(one * devicePixelRatio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  screen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  paintAbove(screen, width, height);
}

/** Draw the view from above in a context of a size, px. */
export function paintAbove(context, width, height) {
  context.fillStyle = palette.gutter;
  context.fillRect(0, 0, width, height);
  const { band, shown, labels, avoided, scene: { measured } } = now;
  clearLabels(); // those of the picture lie elsewhere
  const state = { ...now.state, z: now.state.z ?? now.state.x.map(() => 0) };
  const seen = [...state.z, ...(measured?.z ?? []), ...(band?.z?.low ?? []), ...(band?.z?.high ?? []), 0];
  const [low, high] = [Math.min(...seen), Math.max(...seen)];
  const { y, box, magnified } = view;
  const window = { ...box, top: EDGE, height: height - 2 * EDGE };
  const times = Math.min(magnified, (window.height - 2 * ROOM) / (view.scale * (high - low || 1)));
  Object.assign(view, { y: (low + high) / 2, box: window, magnified: times }); // all painters draw in this window
  within(context, window, () => {
    paintTissue(context);
    const needle = turn(state);
    if (shown.band && band?.z && isBandNear(band, state)) paintBand(context, { x: band.x, ...band.z }, band.step !== state.step);
    context.lineJoin = "round";
    paintNeedle(context, needle);
    if (measured && shown.measured) paintMeasured(context, { ...measured, y: measured.z });
    setFont(context, "small", "left");
    label(context, "from above", box.left + 6, EDGE + 10);
  });
  paintFrame(context, times === 1 ? "z (mm)" : `z (mm), drawn ${brief(times, 2)}×`);
  Object.assign(view, { y, box, magnified });
  Object.assign(now, { labels, avoided });
}

for (const kind of ["drawn", "scene"]) listen(kind, draw);
new ResizeObserver(draw).observe(canvas);
onScheme(() => requestAnimationFrame(draw));
