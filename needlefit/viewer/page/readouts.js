/** The numbers below the picture, told often enough to read and no more. */

import { degrees, signed } from "./numbers.js";
import { listen, now } from "./store.js";

const list = document.getElementById("readouts");

/** What is read of the needle: a name, a unit, and how it is written from a state. */
const NEEDLE = [
  ["depth", "mm", (s) => s.depth_mm.toFixed(2)],
  ["tip deflection", "mm", (s) => signed(s.tip.deflection_mm, 2)],
  ["tip slope", "°", (s) => signed(degrees(s.tip.slope), 2)],
  ["tip force", "N", (s) => signed(s.forces.tip_n, 3)],
  ["base force", "N", (s) => signed(s.forces.base_n, 3)],
  ["base moment", "N mm", (s) => signed(s.forces.base_nmm, 1)],
  ["steepest slope", "", (s) => s.max_slope.toFixed(3)],
];

/** What is read of the comparison with a measured needle. */
const ERRORS = [
  ["TE", "mm", (e) => e.te_mm?.toFixed(3) ?? "–"],
  ["IPE mean", "mm", (e) => e.ipe_mean_mm.toFixed(3)],
  ["IPE max", "mm", (e) => e.ipe_max_mm.toFixed(3)],
  ["EDP", "%", (e) => e.edp_percent?.toFixed(2) ?? "–"],
  ["noise floor", "mm", (e) => e.floor_mm?.toFixed(3) ?? "–"],
];

let shownErrors = false;
let texts = [];

function build(errors) {
  shownErrors = errors;
  list.replaceChildren();
  texts = NEEDLE.map(([name, unit]) => entry(name, unit));
  if (errors) texts.push(...ERRORS.map(([name, unit]) => entry(name, unit, "error")));
}

function entry(name, unit, kind = "") {
  const [row, term, value, number, small] = ["div", "dt", "dd", "span", "small"].map((tag) => document.createElement(tag));
  row.className = kind;
  term.textContent = name;
  small.textContent = unit;
  value.append(number, " ", small);
  row.append(term, value);
  list.append(row);
  number.textContent = "–";
  return number;
}

/** Write what has changed. */
export function refresh() {
  const { state } = now;
  if ((state.errors !== null) !== shownErrors) build(state.errors !== null);
  const said = NEEDLE.map(([, , write]) => write(state));
  if (state.errors) said.push(...ERRORS.map(([, , write]) => write(state.errors)));
  said.forEach((text, i) => texts[i].textContent !== text && (texts[i].textContent = text));
  if (state.errors) list.dataset.upto = comparedUpTo(state.errors);
}

/** Up to where errors compare: whole, or the part of the measured needle that the needle has reached. */
export function comparedUpTo({ whole, upto_mm: upto }) {
  return whole ? "over the whole insertion" : `over the first ${upto.toFixed(1)} mm`;
}

listen("scene", () => build(false));
