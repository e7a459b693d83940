/** The line to the server: one websocket that comes back by itself. */

import { now, take, tell } from "./store.js";

const FIRST_WAIT = 0.25; // s
const LONGEST_WAIT = 5; // s
const KEPT = 256; // times of inputs not yet answered
const STRANGER = 4401; // closed by the server: it does not know the token

let socket = null;
let timer = 0;
let wait = FIRST_WAIT;
let lastId = 0;
let farewell = null; // what the program said when it stopped
const sentAt = new Map();

/** The token that the address brought; kept, so that a page opened without it still knows it. */
export function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) sessionStorage.setItem("needlefit.token", given);
  return given ?? sessionStorage.getItem("needlefit.token") ?? "";
}

/** Which needle this window holds, or null. */
export const needle = () => sessionStorage.getItem("needlefit.needle");

/** Open the line, or open it anew at once. */
export function open() {
  clearTimeout(timer);
  if (socket && socket.readyState < WebSocket.CLOSING) return;
  const address = new URL("/ws", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  const line = new WebSocket(address);
  socket = line;
  line.onopen = () => {
    lastId = 0;
    sentAt.clear();
    line.send(JSON.stringify({ do: "hello", id: 0, token: token(), needle: needle() }));
  };
  line.onmessage = (event) => hear(line, JSON.parse(event.data));
  line.onclose = ({ code }) => line === socket && lost(code);
}

/** Send an input that happened at `at` (ms, as events have it). Returns its id, or null without a line. */
export function send(message, at = null) {
  if (!now.connected) {
    tell("unsent", message);
    return null;
  }
  lastId += 1;
  if (at !== null) sentAt.set(lastId, at);
  socket.send(JSON.stringify({ ...message, id: lastId }));
  return lastId;
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

function hear(line, message) {
  if (line !== socket) return;
  if (message.kind === "scene") {
    sessionStorage.setItem("needlefit.needle", message.needle);
    wait = FIRST_WAIT;
    farewell = null;
    now.connected = true;
    take(message);
    tell("line", { open: true });
    return;
  }
  if (message.kind === "taken" || message.kind === "bye") {
    socket = null;
    now.connected = false;
    line.close();
    if (message.kind === "bye") {
      farewell = message.what;
      again();
    }
    tell("line", { open: false, why: message.kind, what: farewell });
    return;
  }
  take(message);
}

function lost(code) {
  now.connected = false;
  const why = code === STRANGER ? "stranger" : farewell === null ? "lost" : "bye";
  tell("line", { open: false, why, wait, what: farewell });
  if (code !== STRANGER) again();
}

function again() {
  timer = setTimeout(open, 1000 * wait);
  wait = Math.min(2 * wait, LONGEST_WAIT);
}
