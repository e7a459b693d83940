/** What the words of the page mean, shown on hover, focus and tap. */

import { element, part } from "./dom.js";
import { listen } from "./store.js";

/** One or two sentences each. Those of the model's parameters, from the glossary, and of error metrics come with the scene. */
export const DEFINITIONS = {
  "depth": "Inserted arc length: how much of the needle is beyond the entry.",
  "tip y": "Distance of the tip from the entry axis, y; positive to the left of the entry.",
  "tip slope": "Angle of the needle at its tip against the entry axis.",
  "tip force": "Lateral force on the tip (1 N is the weight of 100 g), as it stood at its last constraint point; between these points it rises and falls. In space forces are magnitudes.",
  "base force": "Lateral force that holds the base.",
  "base moment": "Moment that holds the base.",
  "steepest slope": "Largest slope dy/dx of the needle; the model takes it for small.",
  "bevel": "Side, or roll, to which the bevel turns the cut.",
  "roll": "Roll of the bevel from here on, about x: 0 turns the cut toward +y, 90 toward +z, ±180 toward −y.",
  "tip z": "Distance of the tip from the plane of the entry axis and y.",
  "base y": "Lateral displacement of the base of the needle, as it is set; positive to the left.",
  "base slope": "Angle of the base of the needle against the entry axis, as it is set.",
  "guides": "Guides that hold the needle.",
  "guide": "Where a guide holds the needle: x along the entry, y to its left, slope dy/dx as an angle.",
  "noise floor": "The mean error that perfect parameters would still show if measurements err as stated.",
};

listen("scene", ({ definitions, shape_parameters: shapes }) => {
  Object.assign(DEFINITIONS, definitions);
  for (const { symbol, explanation } of shapes) DEFINITIONS[symbol] = `${explanation[0].toUpperCase()}${explanation.slice(1)}.`;
});

const ROOM = 110; // px, of the highest definition

const shown = element("div", { id: "definition", role: "tooltip", popover: "auto" });
(part("explorer") ?? document.body).append(shown); // a report has a style of its own outside

/** A term that shows the definition of `name`, itself or `called` otherwise; plain text where there is none. */
export function define(name, called = name) {
  if (!(name in DEFINITIONS)) return called;
  const term = element("button", { type: "button", className: "term" }, called);
  term.setAttribute("aria-description", DEFINITIONS[name]);
  term.tabIndex = -1; // a stop for each would stand before every input
  const show = () => {
    const { left, top, bottom } = term.getBoundingClientRect();
    shown.textContent = DEFINITIONS[name];
    shown.style.left = `${Math.max(8, Math.min(left, innerWidth - 296))}px`;
    const above = top > ROOM;
    shown.style.bottom = above ? `${innerHeight - top + 6}px` : "auto";
    shown.style.top = above ? "auto" : `${bottom + 6}px`;
    if (!shown.matches(":popover-open")) shown.showPopover();
  };
  const hide = () => shown.matches(":popover-open") && shown.hidePopover();
  for (const kind of ["pointerenter", "focus", "click"]) term.addEventListener(kind, show);
  for (const kind of ["pointerleave", "blur"]) term.addEventListener(kind, hide);
  return term;
}
