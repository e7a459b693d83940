/** The fields of bevel, tissue, base, tip and guides, and what they ask for. */

import * as act from "./actions.js";
import { part, press } from "./dom.js";
import { makeField, setHome, show } from "./fields.js";
import { listParameters } from "./parameters.js";
import { degrees, numbered, ROLL_FIELD, slope, strengthOf } from "./quantities.js";
import { change, wanted } from "./steering.js";
import { listen, now } from "./store.js";

const digits = (count) => (value) => value.toFixed(count);
const ANGLE = { shown: degrees, meant: slope };
const guides = new Map(); // rows of the list, by number
let fields = []; // [field, () => value], of the scene that is shown

/** A field of one input; `shown` and `meant` turn its value into what is read, and back. */
function inputField(into, [input, item], about, current, { shown = (x) => x, meant = (x) => x } = {}) {
  const ask = (value, how) => change([[input, item, meant(value)]], how);
  const field = makeField(part(into), { ...about, ask });
  fields.push([field, () => shown(wanted(input, item, current()))]);
  return field;
}

listen("scene", (scene) => {
  for (const id of ["bevel-fields", "tissue-fields", "shape-fields", "base-fields", "tip-fields", "guides"]) part(id).replaceChildren();
  fields = [];
  guides.clear();
  buildBevel(scene);
  buildTissue(scene);
  part("shape-part").hidden = !scene.shape_parameters.length;
  buildHeld("base", scene.limits.base_y_mm, [-10, 10]);
  const angle = buildHeld("tip");
  angle.ask = (value, how) => change([["tip_held", null, 1], ["tip_slope", null, slope(value)]], how); // held at a place
});

function buildBevel({ limits, fitted }) {
  const { key, symbol, unit, digits: count, step, here, value } = strengthOf(fitted);
  const about = { unit, write: digits(count), limits: limits[key], step, symbol };
  const name = `${symbol}, ahead of the tip`;
  setHome(inputField("bevel-fields", [here, null], { ...about, name }, () => now.state.bevel[key]), value);
  inputField("bevel-fields", ["bevel_roll_deg", null], ROLL_FIELD, () => now.state.bevel.roll_deg);
  part("throughout").textContent = `Set this ${symbol} in the whole insertion`;
}

function buildTissue(scene) {
  for (const { input, item, into, about } of listParameters(scene)) {
    const field = inputField(into, [input, item], about, () => now.state.layers[item - 1][input]);
    setHome(field, scene.fitted.layers[item - 1][input]);
  }
}

/** Fields of where the base or the tip is held, and its angle, which is returned. */
function buildHeld(of, yLimits, angleLimits) {
  const place = () => now.state[of];
  const y = { of, name: "y", symbol: `${of} y`, unit: "mm", write: digits(3), step: 0.1, limits: yLimits };
  inputField(`${of}-fields`, [`${of}_y_mm`, null], y, () => place().input_y);
  const angle = { of, name: "slope", symbol: `${of} slope`, unit: "°", write: digits(2), step: 0.1, limits: angleLimits };
  const current = () => (of === "base" ? place().input_slope : place().rotation);
  return inputField(`${of}-fields`, [`${of}_slope`, null], angle, current, ANGLE);
}

/** Let every field say what is, or what was asked for last. */
export function refresh() {
  for (const [field, current] of fields) show(field, current());
  const { held } = now.state.tip;
  part("release").disabled = !held;
  part("tip-note").hidden = held;
  for (const [item, row] of guides) {
    if (now.state.guides.some((guide) => guide.item === item)) continue;
    row.part.remove();
    guides.delete(item);
  }
  for (const guide of now.state.guides) refreshGuide(guide);
  part("no-guides").hidden = now.state.guides.length > 0;
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
    part("add-guide").focus(); // its own button is about to go
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
  show(row.x, wanted("guide_x_mm", item, x));
  show(row.y, wanted("guide_y_mm", item, y));
  show(row.slope, degrees(wanted("guide_slope", item, along ?? 0)));
  row.slope.part.hidden = free;
  row.free.ariaPressed = String(free);
}

press("throughout", ({ timeStamp }) => {
  const { here, throughout, value } = strengthOf(now.state.bevel);
  change([[throughout, null, wanted(here, null, value)]], { at: timeStamp });
});
press("home-all", ({ timeStamp }) => {
  const { throughout, value } = strengthOf(now.scene.fitted);
  const layers = now.scene.fitted.layers.flatMap((layer, i) => Object.entries(layer).map(([name, one]) => [name, i + 1, one]));
  change([...layers, [throughout, null, value]], { at: timeStamp });
});
press("release", ({ timeStamp }) => act.toggleTip(timeStamp));
press("add-guide", () => now.state && act.addGuide());
