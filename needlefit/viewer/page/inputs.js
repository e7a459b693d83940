/** The inputs of a file's needle: its depth, bevel and base, and the parameters of the model. */

import * as act from "./actions.js";
import { part, press } from "./dom.js";
import { makeField, setHome, show } from "./fields.js";
import { listParameters } from "./parameters.js";
import { rollOf } from "./model/inputs.js";
import { degrees, describeRoll, numbered, ROLL_FIELD, slope, strengthOf } from "./quantities.js";
import { change } from "./steering.js";
import { listen, now } from "./store.js";

const digits = (count) => (value) => value.toFixed(count);
const guides = new Map(); // rows of the list, by number
let fields = []; // [field, () => value]

/** Make the fields of a scene. Depth and base of a recording have no values to go back to. */
export function buildFields({ scene, recording }) {
  fields = [];
  guides.clear();
  for (const id of ["insertion-fields", "tissue-fields", "shape-fields", "guides"]) part(id).replaceChildren();
  const add = (into, [input, item], about, current, { shown = (x) => x, meant = (x) => x } = {}) => {
    const field = makeField(part(into), { ...about, ask: (value, how) => change([[input, item, meant(value)]], how) });
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
function refresh() {
  for (const [field, current] of fields) show(field, current());
  part("side").textContent = describeRoll(now.state.bevel);
  part("hold-tip").textContent = now.state.tip.held ? "Let go of the tip" : "Hold the tip";
  for (const [item, row] of guides) {
    if (now.state.guides.some((guide) => guide.item === item)) continue;
    row.part.remove();
    guides.delete(item);
  }
  for (const guide of now.state.guides) refreshGuide(guide);
}

/** A row of the list of guides: where one stands, whether the needle turns freely in it, and how to take it away. */
function makeGuide({ item, name: called = numbered(item) }) {
  const row = part("guide-template").content.firstElementChild.cloneNode(true);
  const [free, remove, into] = [".free", ".remove", ".fields"].map((one) => row.querySelector(one));
  row.querySelector("strong").textContent = called;
  remove.ariaLabel = `Remove ${called}`;
  free.ariaLabel = `Needle turns freely in ${called}`;
  const field = (name, unit, count, input, meant = (x) => x) => makeField(into, {
    of: called, name, symbol: "guide", unit, step: 0.1, write: digits(count),
    ask: (value, how) => change([[input, item, meant(value)]], how),
  });
  press(remove, () => {
    change([["guide_engaged", item, 0]]);
    part("add-guide").focus(); // its own button has gone
  });
  press(free, () => change([["guide_turns_freely", item, free.ariaPressed === "true" ? 0 : 1]]));
  part("guides").append(row);
  return {
    part: row, free, x: field("x", "mm", 2, "guide_x_mm"), y: field("y", "mm", 3, "guide_y_mm"),
    slope: field("slope", "°", 2, "guide_slope", slope),
  };
}

function refreshGuide({ item, name, x, y, slope: along, turns_freely: free }) {
  if (!guides.has(item)) guides.set(item, makeGuide({ item, name }));
  const row = guides.get(item);
  show(row.x, x);
  show(row.y, y);
  show(row.slope, degrees(along ?? 0));
  row.slope.part.hidden = free;
  row.free.ariaPressed = String(free);
}

press("add-guide", () => act.addGuide());
press("hold-tip", () => act.toggleTip());
for (const kind of ["state", "unchanged"]) listen(kind, refresh);
