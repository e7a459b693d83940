/** The picture in words, for who does not see it. */

import { degrees, signed } from "./numbers.js";
import { comparedUpTo } from "./readouts.js";
import { now } from "./store.js";

const text = document.getElementById("described");
const said = document.getElementById("said");

/** The needle's state in a few sentences. */
export function inWords() {
  const { state, scene } = now;
  if (!state) return "The needle has not been drawn yet.";
  const { tip, bevel, base, guides, errors } = state;
  const held = guides.length === 1 ? "1 guide" : `${guides.length} guides`;
  const sentences = [
    `The needle is ${state.depth_mm.toFixed(1)} mm deep, of ${scene.length_mm.toFixed(0)} mm.`,
    `Its tip is deflected ${signed(tip.deflection_mm, 2)} mm${tip.held ? " and held there" : ""}, at ${signed(degrees(tip.slope), 1)} degrees.`,
    `The bevel turns the cut toward ${bevel.side > 0 ? "+y" : "−y"}, b is ${bevel.offset_mm.toFixed(3)} mm.`,
    `The base stands at y ${signed(base.y, 2)} mm, at ${signed(degrees(base.slope), 1)} degrees; ${held}.`,
    `Tip force ${signed(state.forces.tip_n, 2)} N, base force ${signed(state.forces.base_n, 2)} N.`,
  ];
  if (errors) {
    sentences.push(`Against the measured needle ${comparedUpTo(errors)}: mean in-plane error ${errors.ipe_mean_mm.toFixed(2)} mm, tip error ${errors.te_mm?.toFixed(2) ?? "not defined"} mm.`);
  }
  return sentences.join(" ");
}

/** Keep the text alternative true. */
export function refresh() {
  const words = inWords();
  if (text.textContent !== words) text.textContent = words;
}

/** Say it now. */
export function describe() {
  said.textContent = "";
  requestAnimationFrame(() => (said.textContent = inWords()));
}
