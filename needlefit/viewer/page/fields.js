/** A number that can be set: a name, a field, and where it has limits a slider with a mark. */

import { define, DEFINITIONS } from "./definitions.js";
import { part, press } from "./dom.js";
import { newGesture } from "./steering.js";

const template = /** @type {HTMLTemplateElement} */ (part("field-template"));
const STEPS = 1000; // of a slider
const THUMB = 16; // px, which the slider's thumb takes of its length
/** @type {Record<string, number>} */
const ARROWS = { ArrowUp: 1, ArrowDown: -1 };

/**
 * Put a field at the end of `into`; returns what shows a value in it. It can go back to `home`, if it has one.
 *
 * With limits it has a slider too, if logarithmic a logarithmic one; what lies beyond them can be typed, and the slider then
 * stands at its end.
 *
 * @param {HTMLElement} into @param {About} about @param {number | undefined} home @param {(value: number, how: Gesture) => void} ask
 */
export function addField(into, about, home, ask) {
  const { name, symbol = name, unit, step, limits = [0, 1], logarithmic, write, read = Number } = about;
  /** @type {Scale[]} */
  const [to, from] = logarithmic ? [(one) => Math.log(Math.max(one, Number.MIN_VALUE)), Math.exp] : [Number, Number];
  const [low, high] = limits.map(to);
  const field = /** @type {HTMLElement} */ (template.content.firstElementChild?.cloneNode(true));
  const [number, slider, mark, back] = ["number", "slider", "mark", "home"].map((kind) => /** @type {any} */ (field.querySelector(`.${kind}`)));
  let [value, gesture] = [NaN, newGesture()]; // that is shown; inputs that are undone together
  /** Where a value stands on the slider, of 1. @type {Scale} */
  const share = (one) => Math.min(Math.max((to(one) - low) / (high - low), 0), 1);
  /** @param {number} one */
  const set = (one) => {
    value = NaN; // what comes is shown even where it is what was
    ask(one, { gesture, below: field });
  };
  /** @param {number} one */
  const setAnew = (one) => {
    gesture = newGesture();
    set(one);
  };

  number.setAttribute("aria-description", DEFINITIONS[symbol]);
  number.ariaLabel = slider.ariaLabel = name + (unit && `, ${unit}`);
  number.step = step;
  field.querySelector(".name")?.append(define(symbol, name));
  field.querySelector(".unit")?.append(unit);
  number.addEventListener("change", () => (number.value === "" ? show(value) : setAnew(read(number.value))));
  number.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    if (!ARROWS[event.key]) return;
    event.preventDefault(); // not every browser states a change at a step
    number.stepUp(ARROWS[event.key]);
    (event.repeat ? set : setAnew)(read(number.value));
  });
  if (!about.limits) slider.parentElement.remove();
  slider.max = STEPS;
  slider.addEventListener("input", () => set(from(low + (slider.value / STEPS) * (high - low)))); // while it moves
  slider.addEventListener("change", () => (gesture = newGesture())); // one movement is undone together
  back.hidden = mark.hidden = home === undefined;
  if (home !== undefined) {
    back.ariaLabel = `${number.ariaLabel}: back to its initial value`;
    back.title = `back to ${write(home)} ${unit}`.trim();
    mark.style.left = `calc(${THUMB / 2}px + ${share(home)} * (100% - ${THUMB}px))`;
    press(back, () => setAnew(home));
  }
  into.append(field);

  /** @param {number} one */
  function show(one) {
    value = one;
    number.value = write(value);
    slider.value = Math.round(STEPS * share(value));
    slider.ariaValueText = `${write(value)} ${unit}`.trim();
    back.disabled = home !== undefined && write(home) === write(value);
  }
  return (/** @type {number} */ one) => { if (one !== value) show(one); };
}
