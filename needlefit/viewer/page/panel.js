/** The fields of bevel, tissue, base and tip, and what they ask for. */

import * as act from "./actions.js";
import { makeField, setHome, show } from "./fields.js";
import { strengthOf } from "./bevel.js";
import { DEFINITIONS } from "./definitions.js";
import { asMpa, degrees, fromMpa, slope } from "./numbers.js";
import { change, wanted } from "./steering.js";
import { listen, now } from "./store.js";

const part = (id) => document.getElementById(id);
const asMm = (value) => value.toFixed(3);
const asShape = (value) => value.toFixed(2);
const asDegrees = (value) => value.toFixed(2);

let fields = []; // [field, () => value], of the scene that is shown

/** A field of one input; `shown` and `meant` turn its value into what is read, and back. */
function inputField(into, [input, item], about, current, { shown = (x) => x, meant = (x) => x } = {}) {
  const ask = (value, how) => change([[input, item, meant(value)]], how);
  const field = makeField(part(into), { ...about, ask });
  fields.push([field, () => shown(wanted(input, item, current()))]);
  return field;
}

const ANGLE = { shown: degrees, meant: slope };

function build(scene) {
  for (const id of ["bevel-fields", "tissue-fields", "base-fields", "tip-fields"]) part(id).replaceChildren();
  fields = [];
  buildBevel(scene);
  buildTissue(scene);
  buildBase(scene);
  buildTip();
}

function buildBevel({ limits, fitted }) {
  const { key, symbol, unit, digits, step, here, throughout, value } = strengthOf(fitted);
  const about = { unit, write: (number) => number.toFixed(digits), limits: limits[key], step };
  const strength = () => now.state.bevel[key];
  for (const [name, input] of [[`${symbol} from here on`, here], [`${symbol} throughout`, throughout]]) {
    setHome(inputField("bevel-fields", [input, null], { ...about, name, symbol }, strength), value);
  }
}

function buildTissue({ layer_names: names, boundaries_mm: tops, limits, fitted, shape_parameters: shapes }) {
  for (let i = 0; i <= tops.length; i += 1) {
    const called = names[i] || `layer ${i + 1}`;
    const layer = () => now.state.layers[i];
    const modulus = { unit: "MPa", write: asMpa, read: fromMpa, logarithmic: true, step: 1.05 };
    const mu = { ...modulus, name: `${called} μ`, symbol: "μ", limits: limits.mu_pa };
    setHome(inputField("tissue-fields", ["mu_pa", i + 1], mu, () => layer().mu_pa), fitted.layers[i].mu_pa);
    for (const { name, symbol, unit, explanation } of shapes) {
      DEFINITIONS[symbol] ??= `${explanation}.`;
      const [low, high] = limits[name];
      const step = Math.min(0.1, (high - low) / 100);
      const about = { name: `${called} ${symbol}`, symbol, unit, write: asShape, limits: limits[name], step };
      setHome(inputField("tissue-fields", [name, i + 1], about, () => layer()[name]), fitted.layers[i][name]);
    }
  }
}

/** The names of the inputs of a layer, in the order of fitted values. */
export const layerInputs = () => ["mu_pa", ...now.scene.shape_parameters.map(({ name }) => name)];

function buildBase({ limits }) {
  const y = { of: "base", name: "y", symbol: "base y", unit: "mm", write: asMm, limits: limits.base_y_mm, step: 0.1 };
  inputField("base-fields", ["base_y_mm", null], y, () => now.state.base.input_y);
  const angle = { of: "base", name: "slope", symbol: "base slope", unit: "°", write: asDegrees, limits: [-10, 10], step: 0.1 };
  inputField("base-fields", ["base_slope", null], angle, () => now.state.base.input_slope, ANGLE);
}

function buildTip() {
  const y = { of: "tip", name: "y", symbol: "tip y", unit: "mm", write: asMm, step: 0.1 };
  inputField("tip-fields", ["tip_y_mm", null], y, () => now.state.tip.input_y);
  const angle = { of: "tip", name: "slope", symbol: "tip slope", unit: "°", write: asDegrees, step: 0.1 };
  const field = inputField("tip-fields", ["tip_slope", null], angle, () => now.state.tip.rotation, ANGLE);
  field.ask = (value, how) => { // a direction is held at a place
    change([["tip_held", null, 1], ["tip_slope", null, slope(value)]], how);
  };
}

/** Let every field say what is, or what was asked for last. */
export function refresh() {
  for (const [field, current] of fields) show(field, current());
  const changed = fields.filter(([{ home, back }]) => home !== null && !back.disabled).map(([{ name }]) => name);
  const words = changed.length ? `Changed by hand: ${changed.join(", ")}.` : "";
  if (part("by-hand").textContent !== words) part("by-hand").textContent = words;
  const { held } = now.state.tip;
  part("release").disabled = !held;
  part("tip-note").hidden = held;
}

function allHome(event) {
  const { layers } = now.scene.fitted;
  const { throughout, value } = strengthOf(now.scene.fitted);
  const set = layers.flatMap((layer, i) => Object.entries(layer).map(([name, value]) => [name, i + 1, value]));
  change([...set, [throughout, null, value]], { at: event.timeStamp });
}

function takeFit({ fault, layers, offset_mm: offset, insertions }) {
  if (!fault) takeFitted(layers, offset, `fitted on this page to ${insertions} measured needle${insertions > 1 ? "s" : ""}`);
}

/** After a fit on the page its values ([mu, shape parameters] of each layer, strength of the bevel) are the ones to go back to. */
export function takeFitted(layers, strength, source) {
  const { fitted } = now.scene;
  const names = layerInputs();
  fitted.layers = layers.map((values) => Object.fromEntries(values.map((value, j) => [names[j], value])));
  fitted[strengthOf(fitted).key] = strength;
  const homes = [strength, strength, ...layers.flat()];
  fields.slice(0, homes.length).forEach(([field], i) => setHome(field, homes[i]));
  part("note").textContent = `Parameters: ${source}.`;
}

listen("scene", build);
listen("fit", takeFit);
part("home-all").addEventListener("click", allHome);
part("release").addEventListener("click", (event) => act.toggleTip(event.timeStamp));
