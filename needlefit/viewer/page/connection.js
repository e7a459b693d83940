/** The line to the server, which comes back by itself; its socket is held by a thread of its own. */

import { makeMailbox, take as takeText } from "./mailbox.js";
import { token } from "./requests.js";
import { now, take, publish } from "./store.js";

const FIRST_WAIT = 0.25; // s
const LONGEST_WAIT = 5; // s
const KEPT = 256; // times of inputs not yet answered
const WORTH_WAITING = 8; // ms that a frame waits for the answer to its input
const GONE =
  "This is a new needle: the program no longer has the one that this page held. Its recording is kept.";
const STRANGER = 4401; // closed by the server: it does not know the token

const worker = new Worker("/page/socket_worker.js", { type: "module" });
const mailbox = makeMailbox();
let opening = false; // whether a socket is open or will be
let timer = 0;
let wait = FIRST_WAIT;
let lastId = 0;
let greeted = false; // whether the server has named the needle of this window
let farewell = null; // the last message of the program, when it stopped
const sentAt = new Map();
let patience = -Infinity; // ms, until when a frame waits

/** Which needle this window holds, or null. */
export const needle = () => sessionStorage.getItem("needlefit.needle");

/** Open the line, or open it anew at once. */
export function open() {
  clearTimeout(timer);
  if (opening) return;
  opening = true;
  greeted = false;
  lastId = 0;
  sentAt.clear();
  const address = new URL("/ws", location.origin.replace("http", "ws")).href;
  const hello = JSON.stringify({ do: "hello", id: 0, token: token(), needle: needle() });
  worker.postMessage({ address, hello, mailbox });
}

/** Send an input that happened at `at` (ms, as events have it). Returns its id, or null without a line. */
export function send(message, at = null) {
  if (!now.connected) {
    publish("unsent", message);
    return null;
  }
  lastId += 1;
  if (at !== null) sentAt.set(lastId, at);
  worker.postMessage({ text: JSON.stringify({ ...message, id: lastId }) });
  publish("sent");
  return lastId;
}

/** Read what has come; also called before each frame. */
function receive() {
  if (!mailbox) return;
  for (let text = takeText(mailbox); text !== null; text = takeText(mailbox)) hear(JSON.parse(text));
}

/**
 * Let the next frame wait for the answer to an input that came with it.
 *
 * The browser holds a wheel's event back until a frame begins; without waiting its effect would be seen one frame
 * later still. The answer takes a few ms, and the frame has them.
 */
export function awaitAnswer() {
  patience = performance.now() + WORTH_WAITING;
}

/** Whether an input has no answer yet. */
export const awaitsAnswer = () => sentAt.size > 0;

/** Read what has come, and what is worth waiting for. */
export function receiveForFrame() {
  receive();
  while (mailbox && sentAt.size && performance.now() < patience) receive();
}

/** When the oldest of the inputs happened that this answer is the first to cover; null if there is none. */
export function answered(id) {
  let oldest = null;
  for (const [sent, at] of sentAt) {
    if (sent > id) break;
    oldest ??= at;
    sentAt.delete(sent);
  }
  if (sentAt.size > KEPT) sentAt.clear();
  return oldest;
}

worker.onmessage = ({ data }) => {
  receive();
  if (data.text) hear(JSON.parse(data.text));
  if (data.closed) lost(data.closed);
};

function hear(message) {
  if (!opening) return; // of a line that was given up
  if (message.kind === "taken" || message.kind === "bye") return leave(message);
  if (message.kind !== "scene") return take(message);
  const gone = !greeted && ![null, message.needle].includes(needle());
  sessionStorage.setItem("needlefit.needle", message.needle);
  greeted = now.connected = true;
  [wait, farewell] = [FIRST_WAIT, null];
  take(message);
  publish("line", { open: true });
  if (gone) publish("notice", { what: GONE });
}

/** The server ends it: another window has the needle, or the program stops. */
function leave({ kind, what = null }) {
  worker.postMessage({ close: true });
  down({ why: kind, what });
  if (kind === "taken") return;
  farewell = what;
  again();
}

function lost(code) {
  const why = code === STRANGER ? "stranger" : farewell === null ? "lost" : "bye";
  down({ why, wait, what: farewell });
  if (code !== STRANGER) again();
}

function down(reason) {
  opening = now.connected = false;
  publish("line", { open: false, ...reason });
}

/** Another address of the program was opened in this window: begin anew with its token. */
addEventListener("hashchange", () => {
  const before = sessionStorage.getItem("needlefit.token");
  if (now.connected && token() === before) return;
  worker.postMessage({ close: true });
  opening = now.connected = false;
  wait = FIRST_WAIT;
  open();
});

function again() {
  timer = setTimeout(open, 1000 * wait);
  wait = Math.min(2 * wait, LONGEST_WAIT);
}
