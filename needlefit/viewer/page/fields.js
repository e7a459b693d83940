/** A number that can be set: a name, a field, and where it has limits a slider with a mark. */

import { define, DEFINITIONS } from "./definitions.js";
import { part, press } from "./dom.js";
import { newGesture } from "./steering.js";
import { publish } from "./store.js";

const template = part("field-template");
const STEPS = 1000; // of a slider
const THUMB = 16; // px, which the slider's thumb takes of its length
const LINEAR = [(x) => x, (x) => x];
const LOGARITHMIC = [(x) => Math.log(Math.max(x, Number.MIN_VALUE)), Math.exp];
const ARROWS = { ArrowUp: 1, ArrowDown: -1 };
const SLIDES = { ...ARROWS, ArrowRight: 1, ArrowLeft: -1, PageUp: 10, PageDown: -10 };
let made = 0;

/**
 * Make a field and put it at the end of `into`.
 *
 * `about` has its `name`, the `symbol` by which it is defined, and `unit`, what it is a number `of` where the name alone is not enough, how to
 * `write` a value and to `read` what is written, and whom to `ask` for another: ask(value, {gesture, below}).
 * With `limits` [low, high] it has a slider too, if `logarithmic` a logarithmic one; what lies beyond them can
 * be typed, and the slider then stands at its end. The arrows add a `step`, or if logarithmic multiply by it.
 */
export function makeField(into, about) {
  const part = template.content.firstElementChild.cloneNode(true);
  const [number, slider, mark, back] = [".number", ".slider", ".mark", ".home"].map((one) => part.querySelector(one));
  const [to, from] = about.logarithmic ? LOGARITHMIC : LINEAR;
  const [low, high] = (about.limits ?? [0, 1]).map(to);
  const field = {
    read: Number, step: 1, ...about, part, number, slider, mark, back,
    value: null, latest: 0, text: "", home: null, editing: false, gesture: newGesture(),
    share: (value) => Math.min(Math.max((to(value) - low) / (high - low), 0), 1),
    at: (share) => from(low + share * (high - low)),
  };
  const { of, name, symbol, unit, limits } = about;
  made += 1;
  number.id = `field-${made}`;
  const term = define(symbol, name);
  if (symbol) number.setAttribute("aria-description", DEFINITIONS[symbol]);
  part.querySelector(".name").append(term);
  part.querySelector(".unit").textContent = unit;
  number.ariaLabel = slider.ariaLabel = [of, name].filter(Boolean).join(" ") + (unit && `, ${unit}`);
  slider.max = STEPS;
  back.ariaLabel = `${number.ariaLabel}: back to its initial value`;
  if (!limits) part.querySelector(".track").remove();
  wireNumber(field);
  // A slider is heard while it moves; all of one movement is undone together.
  const goHome = () => {
    field.gesture = newGesture();
    if (field.home !== null) ask(field, field.home);
  };
  slider.addEventListener("input", () => ask(field, field.at(slider.value / STEPS)));
  slider.addEventListener("change", () => (field.gesture = newGesture()));
  slider.addEventListener("keydown", (event) => event.key in SLIDES && stepBy(field, SLIDES[event.key], event)); // as far as the number goes
  press(back, goHome);
  setHome(field, null);
  into.append(part);
  return field;
}

/** Let a field say what is; what somebody is typing stays. */
export function show(field, value) {
  if (value === field.value) return;
  field.value = field.latest = value;
  const text = (field.text = field.write(value));
  if (!field.editing && field.number.value !== text) field.number.value = text;
  field.slider.value = Math.round(STEPS * field.share(value));
  field.slider.ariaValueText = `${text} ${field.unit}`.trim();
  markHome(field);
}

/** Give a field the value to which it goes back; null: there is none. */
export function setHome(field, home) {
  field.home = home;
  field.back.hidden = field.mark.hidden = home === null;
  if (home === null) return;
  field.mark.style.left = `calc(${THUMB / 2}px + ${field.share(home)} * (100% - ${THUMB}px))`;
  field.back.title = `back to ${field.write(home)} ${field.unit}`.trim();
  markHome(field);
}

/** The way back is open only where there is one to go. */
function markHome({ part, back, write, value, home }) {
  back.disabled = home === null || value === null || write(home) === write(value);
  part.querySelector(".hand").hidden = back.disabled;
}

function ask(field, value) {
  field.latest = value;
  field.value = null; // the answer, which may come at once, is shown even where it is what was
  field.ask(value, { gesture: field.gesture, below: field.part });
}

/** A number counts once it is done: at Enter, at a step of the arrows, or when the field is left. */
function wireNumber(field) {
  const { number } = field;
  number.addEventListener("input", () => (field.editing = true));
  number.addEventListener("blur", () => giveBack(field));
  number.addEventListener("change", () => {
    field.gesture = newGesture();
    field.editing = false;
    if (number.value !== "") return ask(field, field.read(number.value));
    publish("notice", { what: `No ${number.ariaLabel}: ${field.text} is kept.`, expected: "a number" });
    giveBack(field);
  });
  number.addEventListener("keydown", (event) => {
    if (event.key in ARROWS) stepBy(field, ARROWS[event.key], event);
    if (event.key === "Escape") giveBack(field);
  });
  // Not at keydown: the change comes after it, and a state that arrives between them would replace what is typed.
  number.addEventListener("keyup", ({ key }) => { if (key === "Enter") field.editing = false; });
}

/** What was typed and not asked for goes; what is stands there again. */
function giveBack(field) {
  field.editing = false;
  if (field.value !== null) field.number.value = field.text;
}

/** Some steps up or down from what is typed, or else from the value itself, which may have more digits. */
function stepBy(field, direction, event) {
  event.preventDefault();
  const { number, step, logarithmic } = field;
  const from = field.editing && number.value !== "" ? field.read(number.value) : field.latest;
  field.editing = false;
  if (!event.repeat) field.gesture = newGesture();
  ask(field, logarithmic ? from * step ** direction : from + step * direction);
}
