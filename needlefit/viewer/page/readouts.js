/** The numbers below the picture, refreshed often enough to read and no more. */

import { define, DEFINITIONS } from "./definitions.js";
import { signed, toDegrees } from "./numbers.js";
import { listen, now } from "./store.js";
import "./validity.js";

/** What is read of the needle: a name, a unit, and how it is written from a state. */
const NEEDLE = [
  ["depth", "mm", (s) => s.depth_mm.toFixed(2)],
  ["tip y", "mm", (s) => signed(s.tip.lateral_mm, 2)],
  ["tip slope", "°", (s) => signed(toDegrees(s.tip.rotation), 2)],
  ["tip force", "N", (s) => signed(s.forces.tip_n, 3)],
  ["base force", "N", (s) => signed(s.forces.base_n, 3)],
  ["base moment", "N mm", (s) => signed(s.forces.base_nmm, 1)],
  ["steepest slope", "", (s) => s.max_slope.toFixed(3)],
];

/** What is read of the comparison with a measured needle: every metric that the scene names. */
let compared = [];
let errors = [];

function listErrors(metrics) {
  const digits = (unit) => (unit === "%" ? 2 : 3);
  const each = metrics.map(([name, label, unit, text]) => {
    DEFINITIONS[label] = text;
    return [label, unit, (e) => e[name]?.toFixed(digits(unit)) ?? "–"];
  });
  const list = document.getElementById("errors");
  list.replaceChildren();
  compared = [...each, ["noise floor", "mm", (e) => e.floor_mm?.toFixed(3) ?? "–"]];
  errors = fill(list, compared);
}

const needle = fill(document.getElementById("readouts"), NEEDLE);
const against = document.getElementById("against");

/** Put the names and units of readouts into a list; returns where their numbers stand. */
function fill(list, readouts) {
  return readouts.map(([name, unit]) => {
    const tags = ["div", "dt", "dd", "span", "small"];
    const [row, term, value, number, small] = tags.map((tag) => document.createElement(tag));
    term.append(define(name));
    small.textContent = unit;
    number.textContent = "–";
    value.append(number, " ", small);
    row.append(term, value);
    list.append(row);
    return number;
  });
}

function write(numbers, readouts, from) {
  readouts.forEach(([, , say], i) => showText(numbers[i], from ? say(from) : "–"));
}

function showText(part, text) {
  if (part.textContent !== text) part.textContent = text;
}

/** Write what has changed. */
export function refresh() {
  const { state, scene } = now;
  write(needle, NEEDLE, state);
  if (!scene.measured) return;
  write(errors, compared, state.errors);
  showText(against, `against ${scene.measured.id}${state.errors ? `, ${comparedUpTo(state.errors)}` : ""}`);
}

/** Up to where errors compare: whole, or the part of the measured needle that the needle has reached. */
export function comparedUpTo({ whole, upto_mm: upto }) {
  return whole ? "over the whole insertion" : `over the first ${upto.toFixed(1)} mm`;
}

listen("scene", ({ measured }) => {
  document.getElementById("compared").hidden = measured === null;
  if (measured) listErrors(measured.metrics);
});
