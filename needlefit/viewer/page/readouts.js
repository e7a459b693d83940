/** The numbers below the picture, told often enough to read and no more. */

import { degrees, signed } from "./numbers.js";
import { listen, now } from "./store.js";
import { exceeded } from "./validity.js";

/** What is read of the needle: a name, a unit, how it is written from a state, and a remark on it. */
const NEEDLE = [
  ["depth", "mm", (s) => s.depth_mm.toFixed(2)],
  ["tip deflection", "mm", (s) => signed(s.tip.deflection_mm, 2)],
  ["tip slope", "°", (s) => signed(degrees(s.tip.slope), 2)],
  ["tip force", "N", (s) => signed(s.forces.tip_n, 3)],
  ["base force", "N", (s) => signed(s.forces.base_n, 3)],
  ["base moment", "N mm", (s) => signed(s.forces.base_nmm, 1)],
  ["steepest slope", "", (s) => s.max_slope.toFixed(3), exceeded],
];

/** What is read of the comparison with a measured needle. */
const ERRORS = [
  ["TE", "mm", (e) => e.te_mm.toFixed(3)],
  ["IPE mean", "mm", (e) => e.ipe_mean_mm.toFixed(3)],
  ["IPE max", "mm", (e) => e.ipe_max_mm.toFixed(3)],
  ["EDP", "%", (e) => e.edp_percent?.toFixed(2) ?? "–"],
  ["noise floor", "mm", (e) => e.floor_mm?.toFixed(3) ?? "–"],
];

const needle = fill(document.getElementById("readouts"), NEEDLE);
const errors = fill(document.getElementById("errors"), ERRORS);
const against = document.getElementById("against");

/** Put the names and units of readouts into a list; returns where their numbers stand. */
function fill(list, readouts) {
  return readouts.map(([name, unit, , remark]) => {
    const tags = ["div", "dt", "dd", "span", "small"];
    const [row, term, value, number, small] = tags.map((tag) => document.createElement(tag));
    term.textContent = name;
    small.textContent = unit;
    number.textContent = "–";
    value.append(number, " ", small);
    row.append(term, value);
    row.classList.toggle("wide", remark !== undefined);
    list.append(row);
    return [number, small];
  });
}

function write(numbers, readouts, from) {
  readouts.forEach(([, , say, remark], i) => {
    const [number, beside] = numbers[i];
    tell(number, from ? say(from) : "–");
    if (remark) tell(beside, remark(from));
  });
}

function tell(part, text) {
  if (part.textContent !== text) part.textContent = text;
}

/** Write what has changed. */
export function refresh() {
  const { state, scene } = now;
  write(needle, NEEDLE, state);
  if (!scene.measured) return;
  write(errors, ERRORS, state.errors);
  tell(against, `against ${scene.measured.id}${state.errors ? `, ${comparedUpTo(state.errors)}` : ""}`);
}

/** Up to where errors compare: whole, or the part of the measured needle that the needle has reached. */
export function comparedUpTo({ whole, upto_mm: upto }) {
  return whole ? "over the whole insertion" : `over the first ${upto.toFixed(1)} mm`;
}

listen("scene", ({ measured }) => (document.getElementById("compared").hidden = measured === null));
