/** What a hand can take hold of in the picture, and what dragging it asks for. */

import { turnOver } from "./model/inputs.js";
import { now } from "./store.js";
import { fromPx, fromPy, toPx, toPy, view } from "./view.js";

const [AHEAD, ARM] = [16, 26]; // px, of the bevel's knob before the tip, beside the arrow of the tip force, and aside
const NEAR = { mouse: 16, touch: 28 }; // px
const BEGINS = { across: 3, along: 8, times: 2 }; // px before a drag has a direction; along: so many times as far as across

const angleOf = (slope) => Math.atan(slope * view.magnified);

/** Where the base is drawn, and its direction. */
export const basePlace = ({ base }) => ({ place: [toPx(base.x), toPy(base.y)], angle: angleOf(Math.tan(base.rotation)) });

/** Where a guide is drawn, and its direction. */
export const guidePlace = ({ x, y, slope }) => ({ place: [toPx(x), toPy(y)], angle: angleOf(slope) });

/** Where the tip is drawn, and, ahead of it, the knob on the side to which the bevel turns the cut. */
export function bevelPlace({ tip, bevel }) {
  const [px, py] = [toPx(tip.x), toPy(tip.y)];
  return { tip: [px, py], turn: [px + AHEAD, py - Math.cos((bevel.roll_deg * Math.PI) / 180) * ARM] };
}

/** All handles, the ones drawn last first. */
const listHandles = (state) => [
  { at: bevelPlace(state).turn, cursor: "grab", drag: turnBevel(state) },
  ...state.guides.map((guide) => ({ at: guidePlace(guide).place, cursor: "move", drag: dragGuide(guide) })),
  { at: basePlace(state).place, cursor: "move", drag: dragBase(state) },
];

/** The handle nearest to a place in px, or null; `drag(from, to)` returns what dragging it asks for. */
export function handleAt(px, py, kind = "mouse") {
  /** @type {any} */
  let nearest = null;
  let least = NEAR[kind] ?? NEAR.mouse;
  for (const handle of now.state ? listHandles(now.state) : []) {
    const distance = Math.hypot(handle.at[0] - px, handle.at[1] - py);
    if (distance < least) [nearest, least] = [handle, distance];
  }
  return nearest;
}

const rise = (from, to) => fromPy(to[1]) - fromPy(from[1]);

/** The base moves across, or pushes the needle along: whichever a drag begins with. */
function dragBase({ base, depth_mm: depth, guides }) {
  const reach = now.scene.length_mm + Math.min(0, ...guides.map(({ x }) => x)) - 0.001; // it stays before tissue and guides
  /** @type {boolean | null} */
  let along = null;
  return (from, to) => {
    const [px, py] = [Math.abs(to[0] - from[0]), Math.abs(to[1] - from[1])];
    if (px > BEGINS.along && px > BEGINS.times * py) along ??= true;
    else if (py > BEGINS.across) along ??= false;
    if (along === null) return [];
    if (!along) return [["base_y_mm", null, base.input_y + rise(from, to)]];
    return [["depth_mm", null, Math.min(Math.max(depth + fromPx(to[0]) - fromPx(from[0]), 0), reach)]];
  };
}

/** The knob at the tip turns the bevel over once it is on the other side of the needle. */
function turnBevel({ bevel }) {
  let { side } = bevel;
  return (_, [, py]) => {
    const above = bevelPlace(now.state).tip[1] - py;
    if (above * side > -BEGINS.across) return [];
    side = -side;
    return [turnOver(now.state.bevel.roll_deg)];
  };
}

const dragGuide = ({ item, x, y }) => (from, to) => [
  ["guide_x_mm", item, x + fromPx(to[0]) - fromPx(from[0])],
  ["guide_y_mm", item, y + rise(from, to)],
];
