/** The table of the errors of all methods, and the curves of those that are chosen in it. */

import { element, isDark, part, press, write } from "./dom.js";
import { further, invalidate } from "./drawing.js";
import { between, line, palette } from "./painters/strokes.js";
import { predictionOf, writeError } from "./quantities.js";
import { listen, now } from "./store.js";

const JUDGED = "prediction"; // the method that the verdict judges stands first
const chosen = new Set();
let present = []; // the cells of the needle's own errors

const errorsOf = (values) => now.scene.measured.metrics.map(([name, , unit]) => writeError(values?.[name] ?? null, unit));

/** A colour of a line on paper, as it is on a dark page. */
const lighten = (colour) => between(colour, "#ffffff", 0.4);

listen("scene", ({ measured }) => {
  const { methods } = now.needle;
  part("methods").hidden = !methods;
  if (!methods) return;
  const heads = ["method", ...measured.metrics.map(([, label, unit]) => `${label} (${unit})`)];
  part("method-heads").replaceChildren(...heads.map((one) => element("th", { scope: "col" }, one)));
  const row = (name, values) => element("tr", {}, element("th", { scope: "row" }, name), values.map((one) => element("td", {}, one)));
  const first = row("", errorsOf(null));
  present = [...first.cells];
  const rows = methods.toSorted((one, other) => Number(other.key === JUDGED) - Number(one.key === JUDGED)).map((method) => {
    if (!method.x) return row(method.name, errorsOf(method.errors));
    const swatch = element("i", { className: "swatch line", ariaHidden: "true" });
    swatch.style.background = `light-dark(${method.colour}, ${lighten(method.colour)})`;
    const toggle = element("button", { type: "button", ariaPressed: String(chosen.has(method.key)) }, swatch, method.name);
    press(toggle, () => {
      const on = chosen.has(method.key);
      on ? chosen.delete(method.key) : chosen.add(method.key);
      toggle.ariaPressed = String(!on);
      invalidate();
    });
    return row(toggle, errorsOf(method.errors));
  });
  part("method-rows").replaceChildren(first, ...rows);
});

listen("state", (state) => {
  if (!now.needle.methods) return;
  const { errors } = state;
  const upto = errors && !errors.whole ? `, first ${errors.upto_mm.toFixed(1)} mm` : "";
  const prediction = predictionOf(state, now.scene);
  const called = prediction ? "drawn: our prediction" : `the needle above${upto}`;
  [called, ...errorsOf(prediction?.errors ?? errors)].forEach((text, i) => write(present[i], text));
});

further.push((context) => {
  for (const { key, x, y, colour } of now.needle?.methods ?? []) {
    if (!x || !chosen.has(key)) continue;
    line(context, x, y, palette.halo, 4);
    line(context, x, y, isDark() ? lighten(colour) : colour, 2);
  }
});
