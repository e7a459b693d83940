/** What the page knows, and the listeners to what changes. */



/**
 * All that the page knows; also `window.needlefit`, for whoever measures it. `data` is the file's, `needle` one of its needles,
 * `steered` that needle as it is steered, `state` what is shown of it, `shown` the layers of the picture.
 */
export const now = /** @type {Now} */ (/** @type {Partial<Now>} */ ({
  replay: null, band: null, pinned: null, labels: [], avoided: [],
  shown: { measured: true, band: true, plan: true, pinned: true, errors: false, points: false, path: false, load: false, inset: false },
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

/** Keep a message, then publish it. */
export function take(message) {
  if (message.kind === "scene") Object.assign(now, { scene: message, band: null });
  else if (message.kind === "band") now.band = message.x.length ? message : null; // empty: there is none
  else now[message.kind] = message;
  publish(message.kind, message);
}
