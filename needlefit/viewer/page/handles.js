/** What a hand can take hold of in the picture, and what dragging it asks for. */

import { turnOver } from "./model/inputs.js";
import { now } from "./store.js";
import { fromPx, fromPy, toPx, toPy, view } from "./view.js";

const ARM = { base: 56, guide: 42, bevel: 26 }; // px from a place to what turns it
const AHEAD = 16; // px, of the bevel's knob before the tip: beside the arrow of the tip force
const NEAR = { mouse: 16, touch: 28 }; // px
const BEGINS = { across: 3, along: 8, times: 2 }; // px before a drag has a direction; along: so many times as far as across

const angleOf = (slope) => Math.atan(slope * view.magnified);

/** Where the base is drawn, the ring that turns it (behind it), and its direction. */
export function basePlace({ base }) {
  const [px, py, angle] = [toPx(base.x), toPy(base.y), angleOf(Math.tan(base.rotation))];
  return { place: [px, py], turn: [px - ARM.base * Math.cos(angle), py + ARM.base * Math.sin(angle)], angle };
}

/** Where a guide is drawn, the ring that turns it (beside it), and its direction. */
export function guidePlace({ x, y, slope }) {
  const [px, py, angle] = [toPx(x), toPy(y), angleOf(slope)];
  return { place: [px, py], turn: [px - ARM.guide * Math.sin(angle), py - ARM.guide * Math.cos(angle)], angle };
}

/** Where the tip is drawn, and, ahead of it, the knob on the side to which the bevel turns the cut. */
export function bevelPlace({ tip, bevel }) {
  const [px, py] = [toPx(tip.x), toPy(tip.y)];
  return { tip: [px, py], turn: [px + AHEAD, py - Math.cos((bevel.roll_deg * Math.PI) / 180) * ARM.bevel] };
}

/** All handles, the ones drawn last first. */
function all() {
  const { state } = now;
  const base = basePlace(state);
  const bevel = bevelPlace(state);
  const handles = [
    { at: bevel.turn, cursor: "grab", drag: turnBevel(state) },
    { at: bevel.tip, cursor: "ns-resize", drag: dragTip(state) },
  ];
  const add = (at, cursor, drag) => handles.push({ at, cursor, drag });
  for (const guide of state.guides) {
    const { place, turn } = guidePlace(guide);
    if (!guide.turns_freely) add(turn, "grab", turnGuide(guide, place));
    add(place, "move", dragGuide(guide));
  }
  add(base.turn, "grab", turnBase(state, base.place));
  add(base.place, "move", dragBase(state));
  return handles;
}

/** The handle nearest to a place in px, or null; `drag(from, to)` returns what dragging it asks for. */
export function handleAt(px, py, kind = "mouse") {
  if (!now.state) return null;
  let [nearest, least] = [null, NEAR[kind] ?? NEAR.mouse];
  for (const handle of all()) {
    const distance = Math.hypot(handle.at[0] - px, handle.at[1] - py);
    if (distance < least) [nearest, least] = [handle, distance];
  }
  return nearest;
}

const rise = (from, to) => fromPy(to[1]) - fromPy(from[1]);

/** The base moves across, or pushes the needle along: whichever a drag begins with. */
function dragBase({ base, depth_mm: depth, guides }) {
  const reach = now.scene.length_mm + Math.min(0, ...guides.map(({ x }) => x)) - 0.001; // it stays before tissue and guides
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

const dragTip = ({ tip }) => (from, to) => [["tip_y_mm", null, tip.input_y + rise(from, to)]];

const dragGuide = ({ item, x, y }) => (from, to) => [
  ["guide_x_mm", item, x + fromPx(to[0]) - fromPx(from[0])],
  ["guide_y_mm", item, y + rise(from, to)],
];

/** The base's ring stands behind it: it points away from where the needle goes. */
const turnBase = ({ base }, place) => (_, to) => {
  const stage = base.rotation - base.input_slope; // what the stage's own axis adds
  const along = (to[1] - place[1]) / Math.max(place[0] - to[0], 1) / view.magnified;
  return [["base_slope", null, Math.atan(along) - stage]];
};

/** A guide's ring stands beside it: the guide's direction is across. */
const turnGuide = ({ item }, place) => (_, to) => {
  const [across, up] = [to[0] - place[0], place[1] - to[1]];
  return [["guide_slope", item, -across / Math.max(up, 1) / view.magnified]];
};
