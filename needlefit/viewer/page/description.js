/** The picture in words, for who does not see it. */

import { strengthOf } from "./bevel.js";
import { signed, toDegrees } from "./numbers.js";
import { comparedUpTo } from "./readouts.js";
import { say } from "./announcements.js";
import { now } from "./store.js";
import { exceeded } from "./validity.js";

const text = document.getElementById("described");

/** The needle's state in a few sentences. */
export function inWords() {
  const { state, scene } = now;
  if (!state) return "The needle has not been drawn yet.";
  const { tip, bevel, base, guides, errors } = state;
  const held = guides.length === 1 ? "1 guide" : `${guides.length} guides`;
  const sentences = [
    `The needle is ${state.depth_mm.toFixed(1)} mm deep, of ${scene.length_mm.toFixed(0)} mm.`,
    `Its tip is ${Math.abs(tip.lateral_mm).toFixed(2)} mm to the ${tip.lateral_mm < 0 ? "right" : "left"}${tip.held ? " and held there" : ""}, at ${angle(tip)}.`,
    `The bevel turns the cut toward ${bevel.side > 0 ? "+y" : "−y"}, ${strength(bevel)}.`,
    `The base stands at y ${signed(base.y, 2)} mm, at ${angle(base)}; ${held}.`,
    `Tip force ${signed(state.forces.tip_n, 2)} N, base force ${signed(state.forces.base_n, 2)} N.`,
  ];
  if (exceeded(state)) sentences.push(`The needle is ${exceeded(state)}.`);
  if (errors) {
    const [mean, tipError] = [errors.ipe_mean_mm.toFixed(2), errors.te_mm.toFixed(2)];
    sentences.push(`Against the measured needle ${comparedUpTo(errors)}: IPE mean ${mean} mm, TE ${tipError} mm.`);
  }
  return sentences.join(" ");
}

function strength(bevel) {
  const { symbol, value, digits, unit } = strengthOf(bevel);
  return `${symbol} is ${value.toFixed(digits)} ${unit}`;
}

const angle = ({ rotation }) => `${signed(toDegrees(rotation), 1)} degrees`;

/** Keep the text alternative true. */
export function refresh() {
  const words = inWords();
  if (text.textContent !== words) text.textContent = words;
}

/** Say the needle's state now. */
export const describe = () => say(inWords());
