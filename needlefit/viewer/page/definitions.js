/** What the words of the page mean, shown on hover. */

import { element } from "./dom.js";
import { listen } from "./store.js";

/** Those of the model's parameters and of error metrics come with the scene. */
export const DEFINITIONS = /** @type {Record<string, string>} */ ({
  "depth": "Inserted arc length: how much of the needle is beyond the entry.",
  "tip y": "Distance of the tip from the entry axis, y; positive to the left of the entry.",
  "tip slope": "Angle of the needle at its tip against the entry axis.",
  "steepest slope": "Largest slope dy/dx of the needle; the model takes it for small.",
  "roll": "Roll of the bevel from here on, about x: 0 turns the cut toward +y, 90 toward +z, ±180 toward −y.",
  "tip z": "Distance of the tip from the plane of the entry axis and y.",
  "base y": "Lateral displacement of the base of the needle, as it is set; positive to the left.",
  "base slope": "Angle of the base of the needle against the entry axis, as it is set.",
  "guide": "Where a guide holds the needle: x along the entry, y to its left, slope dy/dx as an angle.",
  "noise floor": "The mean error that perfect parameters would still show if measurements err as stated.",
});

listen("scene", ({ definitions, shape_parameters: shapes }) => {
  Object.assign(DEFINITIONS, definitions);
  for (const { symbol, explanation } of shapes) DEFINITIONS[symbol] = `${explanation[0].toUpperCase()}${explanation.slice(1)}.`;
});

/** A term that shows the definition of `name`, itself or `called` otherwise; plain text where there is none. @param {string} name */
export const define = (name, called = name) =>
  (name in DEFINITIONS ? element("span", { className: "term", title: DEFINITIONS[name] }, called) : called);
