/** The buttons below the picture: what part is seen, what of it, and the pinned needle. */

import { element, part, press, write } from "./dom.js";
import { listen, now, redraw } from "./store.js";
import { fit, view } from "./view.js";

/** The layers of the picture: what the button of each is called, and explained. @type {Record<Shown, string[]>} */
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
const NAMES = /** @type {Shown[]} */ (Object.keys(CHIPS));
/** @type {NodeListOf<HTMLElement & { dataset: { fit: View["fit"] } }>} */
const fits = document.querySelectorAll("[data-fit]");
const chips = NAMES.map((name) => {
  const [called, title = ""] = CHIPS[name];
  const swatch = element("i", { ariaHidden: "true", className: `swatch ${name}` });
  const chip = element("button", { type: "button", title, ariaPressed: String(now.shown[name]) }, swatch, called);
  chip.dataset.show = name;
  press(chip, () => {
    now.shown[name] = !now.shown[name];
    chip.ariaPressed = String(now.shown[name]);
    redraw();
  });
  return chip;
});
part("chips").append(...chips);

/** Keep the needle as it stands to compare with, or forget the one that was kept. */
export function pin() {
  const { x, y, z } = now.state;
  setPinned(now.pinned ? null : { x, y, z });
}

/** Offer what there is. @param {Curve | null} pinned */
function setPinned(pinned) {
  now.pinned = pinned;
  part("pin").ariaPressed = String(Boolean(pinned));
  write("pin", pinned ? "Unpin" : "Pin");
  const { measured, draws, plan } = now.scene;
  const there = { measured, errors: measured, band: draws, plan, pinned, points: true, path: true, load: true, inset: true };
  NAMES.forEach((name, i) => (chips[i].hidden = !there[name]));
  redraw();
}

press("pin", pin);
for (const one of fits) press(one, () => fit(one.dataset.fit));
listen("scene", () => setPinned(null));
listen("redraw", () => fits.forEach((one) => (one.ariaPressed = String(one.dataset.fit === view.fit)))); // of another view
