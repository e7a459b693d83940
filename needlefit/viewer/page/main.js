/** Starts the page: the line to the server, the picture, and the readouts beside it. */

import { open } from "./connection.js";
import * as described from "./description.js";
import { paint } from "./drawing.js";
import "./exports.js";
import * as frames from "./frames.js";
import * as guides from "./guides.js";
import "./live_fit.js";
import "./keys.js";
import "./notices.js";
import "./opening.js";
import * as panel from "./panel.js";
import * as planning from "./planning.js";
import "./pointers.js";
import * as readouts from "./readouts.js";
import * as status from "./status.js";
import { askFrame } from "./steering.js";
import { listen, now } from "./store.js";
import "./toolbar.js";
import "./tracking.js";
import * as transport from "./transport.js";

const READOUTS = [ // beside the picture, and how often they are refreshed, ms
  { every: 100, refresh: readouts.refresh },
  { every: 100, refresh: transport.refresh },
  { every: 200, refresh: panel.refresh },
  { every: 200, refresh: guides.refresh },
  { every: 200, refresh: planning.refresh },
  { every: 1000, refresh: described.refresh },
];
const STATUS_EVERY = 500; // ms
const BETWEEN = 20; // ms between two readouts that no frame refreshes
let later = 0;

/** Refresh one readout that is due in a frame, so that no frame has to wait for all of them; others soon after it. */
function refreshOne(t) {
  clearTimeout(later);
  if (!now.state) return;
  const waiting = READOUTS.filter((one) => one.step !== now.state);
  const due = waiting.find((one) => t - (one.last ?? -Infinity) >= one.every);
  if (waiting.length) later = setTimeout(() => refreshOne(performance.now()), BETWEEN);
  if (!due) return;
  due.last = t;
  due.step = now.state;
  due.refresh();
}

listen("refused", () => { // fields go back to what is
  READOUTS.forEach((one) => (one.step = null));
  refreshOne(performance.now());
});

frames.start((fresh, t) => {
  if (now.state) askFrame(); // the needle goes on while this frame is drawn
  paint(fresh);
  refreshOne(t);
});
setInterval(status.refresh, STATUS_EVERY);
open();
