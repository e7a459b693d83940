/** The buttons above the picture: what part is seen, what of it, and the pinned needle. */

import { button, element, part, press } from "./dom.js";
import { listen, now, redraw } from "./store.js";
import { fit, view, zoom } from "./view.js";

/** The layers of the picture: what the button of each is called, and explained. */
const CHIPS = {
  load: ["lateral load"],
  points: ["constraint points"],
  path: ["tip path"],
  measured: ["measured"],
  errors: ["errors", "Gaps at the tip (TE) and along the shaft (IPE)"],
  band: ["95 % band", "95 % of the needles lie wholly inside"],
  plan: ["plan"],
  pinned: ["pinned"],
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

/** Keep the needle as it stands to compare with, or forget the one that was kept. */
export function pin() {
  if (!now.state) return;
  const { x, y } = now.state;
  now.pinned = now.pinned ? null : { x, y };
  part("pin").ariaPressed = String(now.pinned !== null);
  part("pin").textContent = now.pinned ? "Unpin" : "Pin";
  offer({ pinned: now.pinned });
  redraw();
}

/** Offer what there is, by name. */
const offer = (there) => Object.entries(there).forEach(([name, is]) => (chips[name].hidden = !is));

offer({ measured: false, errors: false, band: false, plan: false, pinned: false });
press("pin", pin);
for (const one of fits) press(one, () => fit(one.dataset.fit));
for (const [way, factor] of [["in", 1.25], ["out", 0.8]]) press(document.querySelector(`[data-zoom=${way}]`), () => zoom(factor));
listen("scene", ({ measured, draws, plan }) => offer({ measured, errors: measured, band: draws, plan }));
listen("redraw", () => fits.forEach((one) => (one.ariaPressed = String(one.dataset.fit === view.fit)))); // of another view
