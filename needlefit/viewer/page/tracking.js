/** A needle that a tracker moves: its connections, why it is frozen, and the running estimate of mu and b. */

import { strengthOf } from "./bevel.js";
import { asMpa, brief } from "./numbers.js";
import { layerInputs, takeFitted } from "./panel.js";
import { command } from "./steering.js";
import { listen, now } from "./store.js";

const part = (id) => document.getElementById(id);
let estimated = 0; // readings of the estimate that the fields show

function write(id, text) {
  if (part(id).textContent !== text) part(id).textContent = text;
}

function take(message) {
  for (const id of ["tracking", "research"]) part(id).hidden = false;
  part("frozen").hidden = !message.frozen;
  part("tracking-release").hidden = !message.frozen;
  write("tracking-frozen", message.frozen && `Frozen: ${message.frozen}.`);
  const devices = Object.entries(message.devices).map(([role, age]) => (age < 1 ? role : `${role} ${age.toFixed(0)} s ago`));
  const heard = devices.length ? `Tracked: ${devices.join(", ")}.` : "No pose has come yet.";
  const peers = `${message.peers} connection${message.peers === 1 ? "" : "s"}`;
  const ignored = message.ignored ? ` ${message.ignored} messages ignored.` : "";
  write("tracking-note", `${peers}. ${heard} ${message.readings} tip reading${message.readings === 1 ? "" : "s"}.${ignored}`);
  if (now.scene) showEstimate(message);
}

/** Write the estimate, and let the fields of mu and b go back to it. */
function showEstimate(message) {
  const { layer_names: names, fitted } = now.scene;
  const { key, symbol, unit, digits } = strengthOf(fitted);
  const rows = message.mu_pa.map((values, i) => [`${names[i] || `layer ${i + 1}`} μ`, values.map(asMpa).map((one) => brief(one, 3)), "MPa"]);
  rows.push([symbol, message[key].map((one) => one.toFixed(digits)), unit]);
  part("tracking-estimate").replaceChildren(...rows.map(([name, [low, median, high], of]) => {
    const [row, term, value] = ["div", "dt", "dd"].map((tag) => document.createElement(tag));
    term.textContent = name;
    value.textContent = `${median} (${low} to ${high}) ${of}`;
    row.append(term, value);
    return row;
  }));
  if (!message.readings || message.readings === estimated || !now.state) return;
  estimated = message.readings;
  const [, ...shapes] = layerInputs();
  const layers = message.mu_pa.map(([, mu], i) => [mu, ...shapes.map((name) => now.state.layers[i][name])]);
  takeFitted(layers, message[key][1], `estimated from ${message.readings} readings of the tracked tip`);
}

part("tracking-release").addEventListener("click", () => command({ do: "release_tracker" }));
part("tracking-forget").addEventListener("click", () => command({ do: "forget_estimate" }));
listen("tracking", take);
listen("scene", () => (estimated = 0));
