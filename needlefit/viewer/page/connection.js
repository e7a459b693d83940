/** The line to the program: steps of the needle go out, and what the program found comes in. */

import { token } from "./requests.js";
import { now, publish, take } from "./store.js";
import { trial } from "./trial.js";

const STEPS_A_MESSAGE = 16;
const GONE = "This is a new needle: the program no longer has the one that this page held. Its recording is kept.";
const STRANGER = 4401; // closed by the server: it does not know the token

let socket = null;
let lastId = 0;
let greeted = false; // whether the server has named the needle of this window
let ended = null; // why the server ended the connection, if it gave a reason: {kind, what}
let heard = Promise.resolve(); // messages are taken one after the other: a scene takes a while
let sent = 0; // steps that were sent

/** Which needle this window holds, or null. */
export const needle = () => sessionStorage.getItem("needlefit.needle");

/** Open the line. A page that is loaded again gets its needle again. */
export function open() {
  socket = new WebSocket(new URL("/ws", location.origin.replace("http", "ws")));
  socket.onopen = () => socket.send(JSON.stringify({ do: "hello", id: 0, token: token(), needle: needle() }));
  socket.onmessage = ({ data }) => (heard = heard.then(() => hear(JSON.parse(data))).catch(reportError));
  socket.onclose = ({ code }) => {
    now.connected = false;
    publish("line", { open: false, why: code === STRANGER ? "stranger" : ended?.kind ?? "lost", what: ended?.what });
  };
}

/** Send a message. Returns its id, or null without a line. */
export function send(message) {
  if (!now.connected) {
    publish("unsent", message);
    return null;
  }
  lastId += 1;
  sendSteps(); // it may be about them
  socket.send(JSON.stringify({ ...message, id: lastId }));
  return lastId;
}

/** Send the steps that the server does not have yet. */
export function sendSteps() {
  if (!now.connected) return;
  const first = Math.max(sent - trial.recorded, 0);
  for (let i = first; i < trial.outbox.length; i += STEPS_A_MESSAGE) {
    const steps = trial.outbox.slice(i, i + STEPS_A_MESSAGE);
    socket.send(JSON.stringify({ do: "steps", id: 0, steps }));
  }
  sent = trial.recorded + trial.outbox.length;
}

/** Resolves once the program has recorded all steps. */
export async function settle() {
  sendSteps();
  while (now.connected && trial.outbox.length) await new Promise((done) => setTimeout(done, 10));
}

async function hear(message) {
  if (message.kind === "taken" || message.kind === "bye") return void (ended = message);
  if (message.kind === "recorded") return trial.confirm(message.step);
  if (message.kind !== "scene") return take(message);
  const gone = !greeted && ![null, message.needle].includes(needle());
  sessionStorage.setItem("needlefit.needle", message.needle);
  greeted = true;
  await trial.begin(message);
  sent = trial.recorded;
  now.connected = true;
  take(trial.scene);
  trial.show();
  publish("line", { open: true });
  if (gone) publish("notice", { what: GONE });
}

addEventListener("hashchange", () => location.reload()); // another address of the program was opened in this window
addEventListener("pagehide", sendSteps);
