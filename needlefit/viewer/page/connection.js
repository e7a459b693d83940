/** The line to the program, which comes back by itself: steps of the needle go out, and what the program found comes in. */

import { token } from "./requests.js";
import { now, publish, take } from "./store.js";
import { trial } from "./trial.js";

const FIRST_WAIT = 0.25; // s
const LONGEST_WAIT = 5; // s
const STEPS_A_MESSAGE = 16;
const GONE =
  "This is a new needle: the program no longer has the one that this page held. Its recording is kept.";
const STRANGER = 4401; // closed by the server: it does not know the token

let socket = null;
let timer = 0;
let wait = FIRST_WAIT;
let lastId = 0;
let greeted = false; // whether the server has named the needle of this window
let farewell = null; // the last message of the program, when it stopped
let heard = Promise.resolve(); // messages are taken one after the other: a scene takes a while
let sent = 0; // steps that were sent over this line

/** Which needle this window holds, or null. */
export const needle = () => sessionStorage.getItem("needlefit.needle");

/** Open the line, or open it anew at once. */
export function open() {
  clearTimeout(timer);
  if (socket) return;
  greeted = false;
  const line = new WebSocket(new URL("/ws", location.origin.replace("http", "ws")));
  socket = line;
  const mine = (work) => (...given) => line === socket && work(...given); // not of a line that was given up
  const known = trial.scene?.needle === needle() ? trial.recorded : 0;
  line.onopen = mine(() => line.send(JSON.stringify({ do: "hello", id: 0, token: token(), needle: needle(), known })));
  line.onmessage = mine(({ data }) => (heard = heard.then(mine(() => hear(JSON.parse(data)))).catch(reportError)));
  line.onclose = mine(({ code }) => lost(code));
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
  if (message.kind === "taken" || message.kind === "bye") return leave(message);
  if (message.kind === "recorded") return trial.confirm(message.step);
  if (message.kind !== "scene") return take(message);
  const gone = !greeted && ![null, message.needle].includes(needle());
  sessionStorage.setItem("needlefit.needle", message.needle);
  greeted = true;
  [wait, farewell] = [FIRST_WAIT, null];
  if (!(await trial.begin(message))) return beginAnew();
  sent = trial.recorded;
  now.connected = true;
  take(trial.scene);
  trial.show();
  publish("line", { open: true });
  sendSteps();
  if (gone) publish("notice", { what: GONE });
}

/** Carry out all steps of the needle from the first on: another window moved it. */
function beginAnew() {
  trial.scene = null;
  close();
  open();
}

/** The server ends it: another window has the needle, or the program stops. */
function leave({ kind, what = null }) {
  close();
  down({ why: kind, what });
  if (kind === "taken") return;
  farewell = what;
  again();
}

function lost(code) {
  const why = code === STRANGER ? "stranger" : farewell === null ? "lost" : "bye";
  close();
  down({ why, wait, what: farewell });
  if (code !== STRANGER) again();
}

function close() {
  const line = socket;
  socket = null;
  line?.close();
}

function down(reason) {
  now.connected = false;
  publish("line", { open: false, ...reason });
}

/** Another address of the program was opened in this window: begin anew with its token. */
addEventListener("hashchange", () => {
  const before = sessionStorage.getItem("needlefit.token");
  if (now.connected && token() === before) return;
  close();
  now.connected = false;
  wait = FIRST_WAIT;
  open();
});
addEventListener("pagehide", sendSteps);

function again() {
  timer = setTimeout(open, 1000 * wait);
  wait = Math.min(2 * wait, LONGEST_WAIT);
}
