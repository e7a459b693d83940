/** Inputs on their way to the server: the newest one counts, and at most one change is in flight. */

import { send } from "./connection.js";
import { listen, now } from "./store.js";

const SHORTEST = 4; // ms between two changes: a fast mouse must not flood the line

let flight = null; // id of the change that has no answer yet
let frame = null; // id of the frame that has no answer yet
let sentLast = -Infinity; // ms
let timer = 0;
let waiting = []; // changes that are not sent yet, one for each gesture
let held = null; // the gesture of a move that a hand holds
let gestures = Date.now() % 1e9; // a page that was loaded again goes on with numbers of its own
const asked = new Map(); // what was asked for and is not answered yet

/** A number for inputs that are undone together. */
export const newGesture = () => ++gestures;

const key = (name, item) => `${name} ${item ?? ""}`;

/** What an input was last asked to be, or `otherwise` where the server's state already has it. */
export const wanted = (name, item, otherwise) => asked.get(key(name, item))?.value ?? otherwise;

/**
 * Ask for a change.
 * @param set triples [name, item, value], all of one step
 * @param how gesture, insert (mm, relative), at (ms, when the hand did it)
 */
export function change(set, { gesture = newGesture(), insert = 0, at = performance.now() } = {}) {
  gesture = held ?? gesture; // what is steered while the needle moves is undone with the move
  for (const [name, item, value] of set) asked.set(key(name, item), { value, id: Infinity });
  const last = waiting.at(-1);
  if (last?.gesture !== gesture) waiting.push({ gesture, set: [...set], insert, at });
  else {
    last.insert += insert;
    const known = new Map([...last.set, ...set].map((one) => [key(one[0], one[1]), one]));
    last.set = [...known.values()];
  }
  sendSoon();
}

function sendSoon() {
  clearTimeout(timer);
  if (flight !== null || !waiting.length) return;
  const left = sentLast + SHORTEST - performance.now();
  if (left > 0) timer = setTimeout(sendNext, left);
  else sendNext();
}

function sendNext() {
  clearTimeout(timer);
  sentLast = performance.now();
  const { gesture, set, insert, at } = waiting.shift();
  const message = { do: "change", gesture, set };
  if (insert) message.insert_mm = insert;
  flight = send(message, at);
  if (flight === null) return forget();
  for (const [name, item, value] of set) {
    if (asked.get(key(name, item))?.value === value) asked.set(key(name, item), { value, id: flight });
  }
}

/** Send what is no change, after all changes that were asked for before it. */
export function command(message, at = performance.now()) {
  while (waiting.length) sendNext();
  return send(message, at);
}

/** Insert (retract, if negative) at a speed, mm/s: on to a depth, or as long as it is held. */
export function move(speed, to = null) {
  const gesture = newGesture();
  held = to === null ? gesture : null;
  const message = { do: "move", gesture, speed_mm_s: speed };
  command(to === null ? message : { ...message, to_mm: to });
}

export function halt() {
  held = null;
  if (now.connected) command({ do: "halt" });
}

/** Let go of a move that a hand holds; one that goes on to a depth goes on. */
export function letGo() {
  if (held !== null) halt();
}

/** Ask for the next frame of what goes on by itself; a hidden page asks for none, and its needle stands. */
export function askFrame() {
  const { moving, playing } = now.state;
  if (frame === null && now.connected && (moving || playing)) frame = send({ do: "frame" });
}

function heard({ answers }) {
  for (const [name, { id }] of asked) if (id <= answers) asked.delete(name);
  if (frame !== null && answers >= frame) frame = null;
  if (flight === null || answers < flight) return;
  flight = null;
  sendSoon();
}

function forget() {
  flight = frame = held = null;
  clearTimeout(timer);
  waiting = [];
  asked.clear();
}

listen("state", heard);
listen("refused", heard);
listen("line", forget);
addEventListener("blur", letGo);
document.addEventListener("visibilitychange", () => document.hidden && letGo());
