/** What the page knows, and the listeners to what changes. */

/** @typedef {import("./types").Now} Now */

/**
 * All that the page knows; also `window.needlefit`, for whoever measures it. `data` is the file's, `needle` one of its needles,
 * `steered` that needle as it is steered, `state` what is shown of it; `forces`: on the tip, N, as it stood at each constraint
 * point, by depth, mm. `shown` are the layers of the picture, `curves` the methods whose needles are drawn.
 */
export const now = /** @type {Now} */ (/** @type {Partial<Now>} */ ({
  replay: null, playing: null, band: null, pinned: null, forces: { x: [], y: [] },
  shown: { load: false, points: false, path: false, errors: false, measured: true, band: true, plan: true, pinned: true },
  curves: new Set(), labels: [], avoided: [],
}));
Object.assign(window, { needlefit: now });

const listeners = new Map();

/** Call `hear(message)` for every message of this kind. */
export function listen(kind, hear) {
  if (!listeners.has(kind)) listeners.set(kind, []);
  listeners.get(kind).push(hear);
}

export function publish(kind, message) {
  for (const hear of listeners.get(kind) ?? []) hear(message);
}

/** Have the picture drawn in the next frame. */
export const redraw = () => publish("redraw");

/** The tip force as it was at the last constraint point, N; null until it has been computed. */
export const tipForce = () => now.forces.y.at(-1) ?? null;

/** Keep a message, then publish it. */
export function take(message) {
  if (message.kind === "scene") Object.assign(now, { scene: message, band: null, forces: { x: [], y: [] } });
  else if (message.kind === "band") now.band = message.x.length ? message : null; // empty: there is none
  else now[message.kind] = message;
  publish(message.kind, message);
}
