/** The inputs of a file's needle: its depth, bevel, base and guides, and the parameters of the model. */

import { part } from "./dom.js";
import { makeField, setHome, show } from "./fields.js";
import { rollOf } from "./model/inputs.js";
import { brief, degrees, describeRoll, modulusLike, shortName, slope, strengthOf } from "./quantities.js";
import { change } from "./steering.js";
import { listen, now } from "./store.js";

const digits = (count) => (value) => value.toFixed(count);
let fields = []; // [field, () => value]



/** Make the fields of a scene. Depth, base and guides of a recording have no values to go back to. @param {Needle} needle */
export function buildFields({ scene, recording }) {
  fields = [];
  for (const id of ["insertion-fields", "guide-fields", "tissue-fields", "shape-fields"]) part(id).replaceChildren();
  const add = (into, [input, item], about, current, { shown = (x) => x, meant = (x) => x } = {}) => {
    const field = makeField(part(into), { ...about, ask: (value, how) => change([[input, item, meant(value)]], how) });
    const home = recording && ["insertion-fields", "guide-fields"].includes(into) ? undefined : current(scene.fitted);
    if (home !== undefined) setHome(field, shown(home));
    fields.push([field, () => shown(current(now.state))]);
  };
  const { limits, fitted, simulation, layer_names: names, shape_parameters: shapes } = scene;
  const { steps: [first], law } = simulation;
  const mm = { unit: "mm", step: 0.1 };
  const tilt = { unit: "°", step: 0.1, write: digits(2) };
  const angle = { shown: degrees, meant: slope };
  add("insertion-fields", ["depth_mm", null],
    { ...mm, name: "depth", symbol: "depth", step: 1, write: digits(1), limits: [0, limits.depth_mm - 0.01] },
    (of) => of.depth_mm ?? scene.depth_mm);
  add("insertion-fields", ["base_y_mm", null],
    { ...mm, name: "base y", symbol: "base y", write: digits(2), limits: [-10, 10] },
    (of) => (of.base ? of.base.input_y : first.controls.baseY));
  add("insertion-fields", ["base_slope", null], { ...tilt, name: "base slope", symbol: "base slope", limits: [-5, 5] },
    (of) => (of.base ? of.base.input_slope : first.controls.baseSlope), angle);
  add("insertion-fields", ["bevel_roll_deg", null],
    { name: "roll", symbol: "roll", unit: "°", step: 10, limits: [-180, 180], write: (value) => brief(value, 6) },
    (of) => (of.bevel ?? { roll_deg: rollOf(first.bevel) }).roll_deg);
  first.controls.guides.forEach((guide, i) => {
    const item = i + 1;
    const read = (key) => (of) => (of.guides?.find((one) => one.item === item) ?? guide)[key] ?? 0;
    const name = (axis) => ({ name: `guide ${shortName({ item, name: guide.name })}, ${axis}`, symbol: "guide" });
    add("guide-fields", ["guide_x_mm", item], { ...mm, ...name("x"), write: digits(2) }, read("x"));
    add("guide-fields", ["guide_y_mm", item], { ...mm, ...name("y"), write: digits(3) }, read("y"));
    if (guide.slope !== null) add("guide-fields", ["guide_slope", item], { ...tilt, ...name("slope") }, read("slope"), angle);
  });
  part("guide-part").hidden = !first.controls.guides.length;
  const { key, symbol, unit, digits: count, step, here, throughout } = strengthOf(fitted);
  const varies = recording?.some(([, changes]) => changes.some(([name]) => name === here)); // it has no value of the whole insertion
  if (!varies) add("tissue-fields", [throughout, null],
    { name: symbol, symbol, unit, step, write: digits(count), limits: limits[key] },
    (of) => (of.bevel ?? of)[key]);
  part("shape-part").hidden = !law.terms || !shapes.length; // a law that is a table has been computed for these parameters alone
  fitted.layers.forEach((layer, i) => {
    const called = names[i] || `layer ${i + 1}`;
    add("tissue-fields", ["mu_pa", i + 1],
      { ...modulusLike(layer.mu_pa), name: `μ ${called}`, symbol: "μ", logarithmic: true, step: 1.05, limits: limits.mu_pa },
      (of) => of.layers[i].mu_pa);
    if (!law.terms) return;
    for (const { name, symbol, unit } of shapes) {
      const [low, high] = limits[name];
      const about = { name: `${symbol} ${called}`, symbol, unit, step: Math.min(0.1, (high - low) / 100), write: digits(2), limits: [low, high] };
      add("shape-fields", [name, i + 1], about, (of) => of.layers[i][name]);
    }
  });
}

/** Let every field say what is. */
function refresh() {
  for (const [field, current] of fields) show(field, current());
  part("side").textContent = describeRoll(now.state.bevel);
}

for (const kind of ["state", "unchanged"]) listen(kind, refresh);
