/** A number that can be set: a name, a field, and where it has limits a slider with a mark. */

import { define, DEFINITIONS } from "./definitions.js";
import { part, press } from "./dom.js";
import { newGesture } from "./steering.js";

const template = /** @type {HTMLTemplateElement} */ (part("field-template"));
const STEPS = 1000; // of a slider
const THUMB = 16; // px, which the slider's thumb takes of its length
/** @type {[Scale, Scale]} */
const LINEAR = [(x) => x, (x) => x];
/** @type {[Scale, Scale]} */
const LOGARITHMIC = [(x) => Math.log(Math.max(x, Number.MIN_VALUE)), Math.exp];
/** @type {Record<string, number>} */
const ARROWS = { ArrowUp: 1, ArrowDown: -1 };
/** @type {Record<string, number>} */
const SLIDES = { ...ARROWS, ArrowRight: 1, ArrowLeft: -1, PageUp: 10, PageDown: -10 };
let made = 0;

/**
 * With limits it has a slider too, if logarithmic a logarithmic one; what lies beyond them can be typed, and the slider then
 * stands at its end. The arrows add a step, or if logarithmic multiply by it.
 */
export class Field {
  /** @type {number | null} */
  value = null; // that is shown
  /** @type {number | null} */
  home = null; // to which it goes back
  latest = 0; // that was asked for
  editing = false; // what somebody is typing stays
  gesture = newGesture();

  /** Make a field and put it at the end of `into`. @param {HTMLElement} into @param {About & { ask: (value: number, how: Gesture) => void }} about */
  constructor(into, about) {
    const { name, symbol = name, unit, limits = [0, 1], logarithmic } = about;
    const [to, from] = logarithmic ? LOGARITHMIC : LINEAR;
    const [low, high] = limits.map(to);
    this.about = about;
    this.part = /** @type {HTMLElement} */ (template.content.firstElementChild?.cloneNode(true));
    /** @type {(kind: string) => any} */
    const find = (kind) => this.part.querySelector(`.${kind}`);
    this.number = find("number");
    this.slider = find("slider");
    this.mark = find("mark");
    this.back = find("home");
    /** Where a value stands on the slider, of 1. @type {Scale} */
    this.share = (value) => Math.min(Math.max((to(value) - low) / (high - low), 0), 1);
    const { number, slider, back } = this;
    made += 1;
    number.id = `field-${made}`;
    number.setAttribute("aria-description", DEFINITIONS[symbol]);
    number.ariaLabel = slider.ariaLabel = name + (unit && `, ${unit}`);
    back.ariaLabel = `${number.ariaLabel}: back to its initial value`;
    find("name").append(define(symbol, name));
    find("unit").textContent = unit;
    slider.max = STEPS;
    if (!about.limits) find("track").remove();
    this.#hear();
    slider.addEventListener("input", () => this.#ask(from(low + (slider.value / STEPS) * (high - low)))); // while it moves
    slider.addEventListener("change", () => (this.gesture = newGesture())); // one movement is undone together
    this.setHome(null);
    into.append(this.part);
  }

  /** Let it say what is. @param {number} value */
  show(value) {
    if (value === this.value) return;
    const { number, slider, about: { unit, write } } = this;
    this.value = this.latest = value;
    if (!this.editing) this.#giveBack();
    slider.value = Math.round(STEPS * this.share(value));
    slider.ariaValueText = `${write(value)} ${unit}`.trim();
    this.#markHome();
  }

  /** Give it the value to which it goes back, or none. @param {number | null} home */
  setHome(home) {
    const { mark, back, about: { unit, write } } = this;
    this.home = home;
    back.hidden = mark.hidden = home === null;
    if (home === null) return;
    mark.style.left = `calc(${THUMB / 2}px + ${this.share(home)} * (100% - ${THUMB}px))`;
    back.title = `back to ${write(home)} ${unit}`.trim();
    this.#markHome();
  }

  /** The way back is open only where there is one to go. */
  #markHome() {
    const { home, value, about: { write } } = this;
    this.back.disabled = home === null || value === null || write(home) === write(value);
  }

  /** @param {number} value */
  #ask(value) {
    this.latest = value;
    this.value = null; // the answer, which may come at once, is shown even where it is what was
    this.about.ask(value, { gesture: this.gesture, below: this.part });
  }

  /** What is typed, in the unit of the input. */
  #read() {
    return (this.about.read ?? Number)(this.number.value);
  }

  /** A number counts once it is done: at Enter, at a step of the arrows, or when the field is left. */
  #hear() {
    const { number, slider, back } = this;
    number.addEventListener("input", () => (this.editing = true));
    number.addEventListener("blur", () => this.#giveBack());
    number.addEventListener("change", () => {
      if (number.value === "") return this.#giveBack();
      this.gesture = newGesture();
      this.editing = false;
      this.#ask(this.#read());
    });
    number.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      this.#step(ARROWS[event.key], event);
      if (event.key === "Escape") this.#giveBack();
    });
    // Not at keydown: the change comes after it, and a state that arrives between them would replace what is typed.
    number.addEventListener("keyup", (/** @type {KeyboardEvent} */ { key }) => { if (key === "Enter") this.editing = false; });
    slider.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.#step(SLIDES[event.key], event)); // as far as the number goes
    press(back, () => {
      this.gesture = newGesture();
      if (this.home !== null) this.#ask(this.home);
    });
  }

  /** What was typed and not asked for goes; what is stands there again. */
  #giveBack() {
    const { number, value, about: { write } } = this;
    this.editing = false;
    if (value !== null && number.value !== write(value)) number.value = write(value);
  }

  /** Some steps up or down from what is typed, or else from the value itself, which may have more digits. @param {number | undefined} count @param {KeyboardEvent} event */
  #step(count, event) {
    if (!count) return;
    event.preventDefault();
    const { step, logarithmic } = this.about;
    const from = this.editing && this.number.value !== "" ? this.#read() : this.latest;
    this.editing = false;
    if (!event.repeat) this.gesture = newGesture();
    this.#ask(logarithmic ? from * step ** count : from + step * count);
  }
}
