/** The buttons below the picture: what part is seen, and what of it. */

import { button, element, part, press } from "./dom.js";
import { listen, now, redraw } from "./store.js";
import { fit, view } from "./view.js";

/** The layers of the picture: what the button of each is called, and explained. */
const CHIPS = {
  measured: ["measured"],
  errors: ["errors", "Gaps at the tip (TE) and along the shaft (IPE)"],
  band: ["95 % band", "95 % of the needles lie wholly inside"],
  plan: ["plan"],
};
/** @type {NodeListOf<HTMLElement>} */
const fits = document.querySelectorAll("[data-fit]");
const chips = Object.fromEntries(Object.entries(CHIPS).map(([name, [called, title = ""]]) => {
  const swatch = element("i", { ariaHidden: "true", className: `swatch ${name}` });
  const chip = button([swatch, called], () => toggle(name), { title, ariaPressed: String(now.shown[name]) });
  chip.dataset.show = name;
  return [name, chip];
}));
part("chips").append(...Object.values(chips));

function toggle(name) {
  now.shown[name] = !now.shown[name];
  chips[name].ariaPressed = String(now.shown[name]);
  redraw();
}

/** Offer what there is, by name. */
const offer = (there) => Object.entries(there).forEach(([name, is]) => (chips[name].hidden = !is));

offer({ measured: false, errors: false, band: false, plan: false });
for (const one of fits) press(one, () => fit(one.dataset.fit));
listen("scene", ({ measured, draws, plan }) => offer({ measured, errors: measured, band: draws, plan }));
listen("redraw", () => fits.forEach((one) => (one.ariaPressed = String(one.dataset.fit === view.fit)))); // of another view
