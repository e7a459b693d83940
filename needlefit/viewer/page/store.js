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

/** @type {{ [kind: string]: ((message: any) => void)[] }} */
const listeners = {};

/** Call `hear(message)` for every message of this kind. @template {keyof Messages} K @param {K} kind @param {(message: Messages[K]) => void} hear */
export const listen = (kind, hear) => (listeners[kind] ??= []).push(hear);

/** @template {keyof Messages} K @param {K} kind @param {Messages[K]} [message] */
export function publish(kind, message) {
  for (const hear of listeners[kind] ?? []) hear(message);
}

/** Have the picture drawn in the next frame. */
export const redraw = () => publish("redraw");

/** Keep what is known anew, then publish it. @template {"scene" | "state" | "band"} K @param {K} kind @param {Messages[K]} message */
export function take(kind, message) {
  Object.assign(now, { [kind]: message });
  publish(kind, message);
}
