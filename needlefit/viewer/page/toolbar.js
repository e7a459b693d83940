/** The buttons below the picture: what part is seen, what of it, and the pinned needle. */

import { button, element, part, press, write } from "./dom.js";
import { listen, now, redraw } from "./store.js";
import { fit, view } from "./view.js";

/** The layers of the picture: what the button of each is called, and explained. */
const CHIPS = {
  measured: ["measured"],
  errors: ["errors", "Gaps at the tip (TE) and along the shaft (IPE)"],
  band: ["95 % band", "95 % of the needles lie wholly inside"],
  plan: ["plan"],
  pinned: ["pinned"],
  points: ["constraint points", "What holds the needle in the tissue: points of the model, not data"],
  path: ["tip path", "Where the tip was at each depth"],
  load: ["load", "Lateral load of the tissue on the shaft, within the limits of the model"],
  inset: ["true scale", "The needle in a corner, with y as large as x"],
};
/** @type {NodeListOf<HTMLElement & { dataset: { fit: View["fit"] } }>} */
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
  const { x, y, z } = now.state;
  setPinned(now.pinned ? null : { x, y, z });
}

/** @param {Curve | null} curve */
function setPinned(curve) {
  now.pinned = curve;
  part("pin").ariaPressed = String(Boolean(curve));
  write("pin", curve ? "Unpin" : "Pin");
  offer({ pinned: curve });
  redraw();
}

/** Offer what there is, by name. */
const offer = (there) => Object.entries(there).forEach(([name, is]) => (chips[name].hidden = !is));

press("pin", pin);
for (const one of fits) press(one, () => fit(one.dataset.fit));
listen("scene", ({ measured, draws, plan }) => {
  offer({ measured, errors: measured, band: draws, plan });
  setPinned(null);
});
listen("redraw", () => fits.forEach((one) => (one.ariaPressed = String(one.dataset.fit === view.fit)))); // of another view
