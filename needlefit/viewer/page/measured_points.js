/** The points of the measured needle that can be dragged, and by how much they were. */

import { now } from "./store.js";

const KNOTS = 6; // evenly spread from entry to tip
const PAUSE = 120; // ms between two messages while one is dragged
let timer = 0;

export const points = {
  shown: false,
  offsets: [],
  send: () => {}, // set by the live fit
  begin() {
    points.shown = false;
    points.offsets = Array(KNOTS).fill(0);
  },
  /** Where the points are now. */
  places() {
    const { x, y } = now.scene.measured;
    return points.offsets.map((_, i) => {
      const at = Math.round((i / (KNOTS - 1)) * (x.length - 1));
      return [x[at], y[at]];
    });
  },
  /** Move one so that it has been dragged by so many mm in all. */
  move(number, offset) {
    points.offsets = points.offsets.with(number, offset);
    timer ||= setTimeout(() => {
      timer = 0;
      points.send();
    }, PAUSE);
  },
  reset() {
    points.offsets = Array(KNOTS).fill(0);
    points.send();
  },
};
