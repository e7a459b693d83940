/** What the server has told, and who wants to hear of it. */

/** The page's knowledge; also `window.needlefit`, for whoever measures the page. */
export const now = { scene: null, state: null, band: null, connected: false, frames: [] };
window.needlefit = now;

const listeners = new Map();

/** Call `hear(message)` whenever something of this kind is told. */
export function listen(kind, hear) {
  if (!listeners.has(kind)) listeners.set(kind, []);
  listeners.get(kind).push(hear);
}

/** Tell all who listen to this kind. */
export function tell(kind, message) {
  for (const hear of listeners.get(kind) ?? []) hear(message);
}

/** Keep what a message of the server says, then tell it. */
export function take(message) {
  if (message.kind === "scene") {
    now.scene = message;
    now.band = null;
  } else if (message.kind === "state") now.state = message;
  else if (message.kind === "band") now.band = message.x.length ? message : null; // empty: there is none
  tell(message.kind, message);
}
