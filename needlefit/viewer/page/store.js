/** The last message of each kind, and the listeners to each. */

/** The page's knowledge (`forces`: on the tip, N, as it stood at each constraint point, by depth, mm); also `window.needlefit`, for whoever measures the page. */
export const now = { scene: null, state: null, band: null, connected: false, pinned: null, marked: null, frames: [], forces: { x: [], y: [] } };
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
  if (message.kind === "scene") {
    now.scene = message;
    now.band = null;
  } else if (message.kind === "state") now.state = message;
  else if (message.kind === "band") now.band = message.x.length ? message : null; // empty: there is none
  else if (message.kind === "forces") now.forces = message;
  publish(message.kind, message);
}
