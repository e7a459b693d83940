/** The inputs of a file's needle: its depth, bevel and base, and the parameters of the model. */

import { part } from "../dom.js";
import { makeField, setHome, show } from "../fields.js";
import { listParameters } from "../parameters.js";
import { rollOf } from "../model/inputs.js";
import { degrees, describeRoll, ROLL_FIELD, slope, strengthOf } from "../quantities.js";
import { now } from "../store.js";

const digits = (count) => (value) => value.toFixed(count);
let fields = []; // [field, () => value]

/** Make the fields of a scene; `steer(changes, below)` carries a change out. Depth and base of a recording have no values to go back to. */
export function buildFields({ scene, recording }, steer) {
  fields = [];
  for (const id of ["insertion-fields", "tissue-fields", "shape-fields"]) part(id).replaceChildren();
  const add = (into, [input, item], about, current, { shown = (x) => x, meant = (x) => x } = {}) => {
    const field = makeField(part(into), { ...about, ask: (value) => steer([[input, item, meant(value)]], field.part) });
    const home = recording && into === "insertion-fields" ? undefined : current(scene.fitted);
    if (home !== undefined) setHome(field, shown(home));
    fields.push([field, () => shown(current(now.state))]);
  };
  const { limits, fitted, simulation } = scene;
  const mm = { unit: "mm", step: 0.1 };
  add("insertion-fields", ["depth_mm", null],
    { ...mm, name: "depth", symbol: "depth", step: 1, write: digits(1), limits: [0, limits.depth_mm - 0.01] },
    (of) => of.depth_mm ?? scene.depth_mm);
  add("insertion-fields", ["base_y_mm", null],
    { ...mm, name: "base y", symbol: "base y", write: digits(2), limits: [-10, 10] },
    (of) => (of.base ? of.base.input_y : simulation.steps[0].controls.baseY));
  add("insertion-fields", ["base_slope", null],
    { name: "base slope", symbol: "base slope", unit: "°", step: 0.1, write: digits(2), limits: [-5, 5] },
    (of) => (of.base ? of.base.input_slope : simulation.steps[0].controls.baseSlope),
    { shown: degrees, meant: slope });
  add("insertion-fields", ["bevel_roll_deg", null], ROLL_FIELD, (of) => (of.bevel ?? { roll_deg: rollOf(simulation.steps[0].bevel) }).roll_deg);
  const { key, symbol, unit, digits: count, step, here, throughout } = strengthOf(fitted);
  const varies = recording?.some(([, changes]) => changes.some(([name]) => name === here)); // it has no value of the whole insertion
  if (!varies) add("tissue-fields", [throughout, null],
    { name: symbol, symbol, unit, step, write: digits(count), limits: limits[key] },
    (of) => (of.bevel ?? of)[key]);
  part("shape-part").hidden = !simulation.law.terms || !scene.shape_parameters.length; // a law that is a table has been computed for these parameters alone
  for (const { input, item, into, about } of listParameters(scene)) {
    if (simulation.law.terms || input === "mu_pa") add(into, [input, item], about, (of) => of.layers[item - 1][input]);
  }
}

/** Let every field say what is. */
export function refreshFields() {
  for (const [field, current] of fields) show(field, current());
  part("side").textContent = describeRoll(now.state.bevel);
}
