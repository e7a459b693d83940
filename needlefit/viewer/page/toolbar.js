/** The buttons above the picture: what part is seen, and what of it. */

import { button, element, part, press } from "./dom.js";
import { invalidate, shown } from "./drawing.js";
import { listen, now } from "./store.js";
import { fit, view, zoom } from "./view.js";

/** What can be shown and hidden: its name, what the button is called and explained, whether it has a swatch. */
const CHIPS = [
  ["load", "lateral load"],
  ["points", "constraint points"], ["path", "tip path"], ["measured", "measured"],
  ["errors", "errors", "Gaps at the tip (TE) and along the shaft (IPE)"], ["band", "95 % band", "95 % of the needles lie wholly inside"], ["plan", "plan"],
  ["pinned", "pinned"],
  ["strip", "tip against depth", "Deflection of the tip and tip force, against depth", false],
];
const TALL = 800; // px of a window that has room for the strip
/** @type {NodeListOf<HTMLElement>} */
const fits = document.querySelectorAll("[data-fit]");
const chips = Object.fromEntries(CHIPS.map(([name, called, title = "", marked = true]) => {
  const swatch = marked ? [element("i", { ariaHidden: "true", className: `swatch ${name}` })] : [];
  const pressed = String(shown[name] ?? false);
  const chip = button([...swatch, called], () => toggle(name), { title, ariaPressed: pressed });
  chip.dataset.show = name;
  return [name, chip];
}));
part("chips").append(...Object.values(chips));

export function toggle(name, on = chips[name].ariaPressed !== "true") {
  chips[name].ariaPressed = String(on);
  if (name === "strip") part("strip").hidden = !on;
  shown[name] = on;
  invalidate();
}

/** Offer what there is, by name. */
const offer = (there) => Object.entries(there).forEach(([name, is]) => (chips[name].hidden = !is));

offer({ measured: false, errors: false, band: false, plan: false, pinned: false });
if (innerHeight < TALL) toggle("strip"); // the picture needs the room
for (const one of fits) press(one, () => fit(one.dataset.fit));
for (const [way, factor] of [["in", 1.25], ["out", 0.8]]) press(document.querySelector(`[data-zoom=${way}]`), () => zoom(factor));
listen("scene", ({ measured, draws, plan }) => offer({ measured, errors: measured, band: draws, plan }));
listen("pinned", () => offer({ pinned: now.pinned }));
listen("redraw", () => fits.forEach((one) => (one.ariaPressed = String(one.dataset.fit === view.fit)))); // of another view
