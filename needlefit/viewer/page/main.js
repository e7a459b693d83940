/** Starts the page: the line to the server, the picture, and everything that is told beside it. */

import { open } from "./connection.js";
import * as described from "./description.js";
import { paint } from "./drawing.js";
import "./exports.js";
import * as frames from "./frames.js";
import * as guides from "./guides.js";
import "./keys.js";
import "./notices.js";
import * as panel from "./panel.js";
import "./pointers.js";
import * as readouts from "./readouts.js";
import * as status from "./status.js";
import { askFrame } from "./steering.js";
import { listen, now } from "./store.js";
import "./toolbar.js";
import * as transport from "./transport.js";

const TOLD = [ // what is told beside the picture, and how often, ms
  { every: 100, refresh: readouts.refresh },
  { every: 100, refresh: transport.refresh },
  { every: 200, refresh: panel.refresh },
  { every: 200, refresh: guides.refresh },
  { every: 1000, refresh: described.refresh },
];
const STATUS_EVERY = 500; // ms

/** Of what is due, tell one thing a frame, so that no frame has to wait for all of it. */
function tellOne(t) {
  const due = TOLD.find((one) => t - (one.last ?? -Infinity) >= one.every && one.step !== now.state);
  if (!due) return;
  due.last = t;
  due.step = now.state;
  due.refresh();
}

listen("refused", () => TOLD.forEach((one) => (one.step = null))); // fields go back to what is

frames.start((fresh, t) => {
  if (now.state) askFrame(); // the needle goes on while this frame is drawn
  paint(fresh);
  if (now.state) tellOne(t);
});
setInterval(status.refresh, STATUS_EVERY);
open();
