/** A needle that a tracker moves: its connections, why it is frozen, and the running estimate of mu and b. */

import { entry, part, press, write } from "./dom.js";
import { layerInputs, takeFitted } from "./panel.js";
import { counted, modulusLike, strengthOf } from "./quantities.js";
import { command } from "./steering.js";
import { listen, now } from "./store.js";

let estimated = 0; // readings of the estimate that the fields show

listen("tracking", (message) => {
  for (const id of ["tracking", "research"]) part(id).hidden = false;
  for (const id of ["frozen", "tracking-release"]) part(id).hidden = !message.frozen;
  write("tracking-frozen", message.frozen && `Frozen: ${message.frozen}.`);
  const devices = Object.entries(message.devices).map(([role, age]) => (age < 1 ? role : `${role} ${age.toFixed(0)} s ago`));
  const heard = devices.length ? `Tracked: ${devices.join(", ")}.` : "No pose has come yet.";
  const ignored = message.ignored ? ` ${message.ignored} messages ignored.` : "";
  const [peers, readings] = [counted(message.peers, "connection"), counted(message.readings, "tip reading")];
  write("tracking-note", `${peers}. ${heard} ${readings}.${ignored}`);
  if (now.scene) showEstimate(message);
});

/** Write the estimate, and let the fields of mu and b go back to it. */
function showEstimate(message) {
  const { layer_names: names, fitted } = now.scene;
  const { key, symbol, unit, digits } = strengthOf(fitted);
  const rows = message.mu_pa.map((values, i) => {
    const { unit: of, write: written } = modulusLike(values[1]);
    return [`μ ${names[i] || `layer ${i + 1}`}`, values.map((one) => written(one, 3)), of];
  });
  rows.push([symbol, message[key].map((one) => one.toFixed(digits)), unit]);
  const entries = rows.map(([name, [low, median, high], of]) => entry(name, `${median} (${low} to ${high}) ${of}`));
  part("tracking-estimate").replaceChildren(...entries);
  if (!message.readings || message.readings === estimated || !now.state) return;
  estimated = message.readings;
  const [, ...shapes] = layerInputs();
  const layers = message.mu_pa.map(([, mu], i) => [mu, ...shapes.map((name) => now.state.layers[i][name])]);
  takeFitted(layers, message[key][1], `estimated from ${message.readings} readings of the tracked tip`);
}

press("tracking-release", () => command({ do: "release_tracker" }));
press("tracking-forget", () => command({ do: "forget_estimate" }));
listen("scene", () => (estimated = 0));
