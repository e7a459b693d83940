/** The inputs of a file's needle: its depth, bevel, base and guides, and the parameters of the model. */

import { part } from "./dom.js";
import { addField } from "./fields.js";
import { rollOf } from "./model/bevel.js";
import { brief, degrees, describeRoll, modulusLike, shortName, slope, strengthOf } from "./quantities.js";
import { change } from "./steering.js";
import { listen, now } from "./store.js";

/** @type {(count: number) => (value: number) => string} */
const digits = (count) => (value) => value.toFixed(count);
let shown = /** @type {(() => void)[]} */ ([]); // what shows the value of each field

const MM = { unit: "mm", step: 0.1, write: digits(2) };
const TILT = { unit: "°", step: 0.1, write: digits(2) };

/** Make the fields of a scene. Depth, base and guides of a recording have no values to go back to. @param {Needle} needle */
export function buildFields({ scene, recording }) {
  shown = [];
  for (const id of ["insertion-fields", "guide-fields", "tissue-fields", "shape-fields"]) part(id).replaceChildren();
  const { limits, fitted, simulation, layer_names: names, shape_parameters: shapes } = scene;
  const { steps: [{ inputs: first }], law } = simulation;

  /** Add a field of an input: its value now, and in the file; a slope is shown as an angle. @type {(into: string, input: string, item: number | null, about: About, read: (state: State) => number, home: number | undefined) => void} */
  const add = (into, input, item, about, read, home) => {
    const [toField, fromField] = input.endsWith("slope") ? [degrees, slope] : [Number, Number];
    const show = addField(part(into), about, home && toField(home), (value, how) => change([[input, item, fromField(value)]], how));
    shown.push(() => show(toField(read(now.state))));
  };
  /** @type {(input: string, about: About, read: (state: State) => number, home: number) => void} */
  const addInput = (input, about, read, home) =>
    add("insertion-fields", input, null, { ...about, symbol: about.name }, read, recording ? undefined : home);
  addInput("depth_mm", { ...MM, name: "depth", step: 1, write: digits(1), limits: [0, limits.depth_mm - 0.01] }, (s) => s.depth_mm, scene.depth_mm);
  addInput("base_y_mm", { ...MM, name: "base y", limits: [-10, 10] }, (s) => s.base.input_y, first.base.y);
  addInput("base_slope", { ...TILT, name: "base slope", limits: [-5, 5] }, (s) => s.base.input_slope, first.base.slope);
  addInput("bevel_roll_deg", { name: "roll", unit: "°", step: 10, limits: [-180, 180], write: (value) => brief(value, 6) },
    (s) => s.bevel.roll_deg, rollOf(first.bevel));
  first.guides.forEach((guide, i) => {
    const item = i + 1;
    /** @param {"x" | "y" | "slope"} axis @param {About} about */
    const addGuide = (axis, about) => add("guide-fields", `guide_${axis}${axis === "slope" ? "" : "_mm"}`, item,
      { ...about, name: `guide ${shortName({ item, name: guide.name })}, ${axis}`, symbol: "guide" },
      (s) => (s.guides.find((one) => one.item === item) ?? guide)[axis] ?? 0, recording ? undefined : guide[axis] ?? 0);
    addGuide("x", { ...MM, name: "" });
    addGuide("y", { ...MM, name: "", write: digits(3) });
    if (guide.slope !== null) addGuide("slope", { ...TILT, name: "" });
  });
  part("guide-part").hidden = !first.guides.length;
  const { symbol, unit, digits: count, step, here, throughout, value } = strengthOf(fitted);
  const varies = recording?.some(([, changes]) => changes.some(([name]) => name === here)); // it has no value of the whole insertion
  if (!varies) {
    const about = { name: symbol, symbol, unit, step, write: digits(count), limits: limits[symbol === "b" ? "offset_mm" : "cut_angle_deg"] };
    add("tissue-fields", throughout, null, about, (s) => strengthOf(s.bevel).value, value);
  }
  part("shape-part").hidden = !law.terms || !shapes.length; // a law that is a table has been computed for these parameters alone
  fitted.layers.forEach((layer, i) => {
    const called = names[i] || `layer ${i + 1}`;
    const about = { ...modulusLike(layer.mu_pa), name: `μ ${called}`, symbol: "μ", logarithmic: true, limits: limits.mu_pa };
    add("tissue-fields", "mu_pa", i + 1, about, (s) => s.layers[i].mu_pa, layer.mu_pa);
    for (const { name, symbol, unit } of law.terms ? shapes : []) {
      const [low, high] = limits[name];
      add("shape-fields", name, i + 1,
        { name: `${symbol} ${called}`, symbol, unit, step: Math.min(0.1, (high - low) / 100), write: digits(2), limits: [low, high] },
        (s) => s.layers[i][name], layer[name]);
    }
  });
}

/** Let every field say what is. */
function refresh() {
  for (const show of shown) show();
  part("side").textContent = describeRoll(now.state.bevel);
}

for (const kind of /** @type {const} */ (["state", "unchanged"])) listen(kind, refresh);
