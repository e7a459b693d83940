/** The table of the errors of all methods, and the curves of those that are chosen in it. */

import { element, part, press, write } from "./dom.js";
import { lighten } from "./painters/overlay.js";
import { isSteered, predictionOf, writeError } from "./quantities.js";
import { listen, now, redraw } from "./store.js";

const JUDGED = "prediction"; // the method that the verdict judges stands first
const FITTED = "fitted"; // the needle that is drawn until it is steered
const own = new Map(); // rows of these methods, which are the needle itself until it is steered
let present = []; // the cells of the needle's own errors

const errorsOf = (values) => (now.scene.measured?.metrics ?? []).map(([name, , unit]) => writeError(values?.[name] ?? null, unit));

listen("scene", ({ measured }) => {
  const { methods } = now.needle;
  part("methods").hidden = !methods;
  if (!methods) return;
  const heads = ["method", ...measured.metrics.map(([, label, unit]) => `${label} (${unit})`)];
  part("method-heads").replaceChildren(...heads.map((one) => element("th", { scope: "col" }, one)));
  const row = (name, values) => element("tr", {}, element("th", { scope: "row" }, name), values.map((one) => element("td", {}, one)));
  const first = row("", errorsOf(null));
  present = [...first.cells];
  own.clear();
  const rows = methods.toSorted((one, other) => Number(other.key === JUDGED) - Number(one.key === JUDGED)).map((method) => {
    const made = makeRow(method, row);
    if ([JUDGED, FITTED].includes(method.key)) own.set(method.key, made);
    return made;
  });
  part("method-rows").replaceChildren(first, ...rows);
});

/** The row of a method; a curve is shown and hidden by its name. */
function makeRow(method, row) {
  if (!method.x) return row(method.name, errorsOf(method.errors));
  const swatch = element("i", { className: "swatch line", ariaHidden: "true" });
  swatch.style.background = `light-dark(${method.colour}, ${lighten(method.colour)})`;
  const toggle = element("button", { type: "button", ariaPressed: String(now.curves.has(method.key)) }, swatch, method.name);
  press(toggle, () => {
    if (!now.curves.delete(method.key)) now.curves.add(method.key);
    toggle.ariaPressed = String(now.curves.has(method.key));
    redraw();
  });
  return row(toggle, errorsOf(method.errors));
}

listen("state", (state) => {
  if (!now.needle.methods) return;
  const { errors } = state;
  const upto = errors && !errors.whole ? `, first ${errors.upto_mm.toFixed(1)} mm` : "";
  const prediction = predictionOf(state, now.scene);
  const steered = isSteered(state, now.scene) || Math.abs(state.depth_mm - now.scene.depth_mm) > 1e-6;
  const known = now.needle.methods.find(({ key }) => key === (prediction ? JUDGED : FITTED));
  const called = steered ? `steered needle${upto}` : (known?.name ?? "the needle above");
  own.forEach((row, key) => (row.hidden = !steered || (key === FITTED && own.has(JUDGED))));
  [called, ...errorsOf(prediction?.errors ?? errors)].forEach((text, i) => write(present[i], text));
});
