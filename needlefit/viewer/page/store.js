/** What the page knows, and the listeners to what changes. */

/**
 * All that the page knows; also `window.needlefit`, for whoever measures it. `data` is the file's, `needle` one of its needles,
 * `steered` that needle as it is steered, `state` what is shown of it; `forces`: on the tip, N, as it stood at each constraint
 * point, by depth, mm.
 */
export const now = {
  data: null, needle: null, steered: null, replay: null,
  scene: null, state: null, band: null, pinned: null, marked: null, forces: { x: [], y: [] }, view: null, labels: [],
};
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

/** The tip force as it was at the last constraint point, N; null until it has been computed. */
export const tipForce = () => now.forces.y.at(-1) ?? null;

/** Keep a message, then publish it. */
export function take(message) {
  if (message.kind === "scene") Object.assign(now, { scene: message, band: null });
  else if (message.kind === "band") now.band = message.x.length ? message : null; // empty: there is none
  else now[message.kind] = message;
  publish(message.kind, message);
}
