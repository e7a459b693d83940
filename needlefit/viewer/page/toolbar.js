/** The buttons above the picture: what part is seen, and what of it. */

import { aim } from "./aim.js";
import { invalidate, shown } from "./drawing.js";
import { listen, now } from "./store.js";
import { drawTrue, fit, refit, touch, view, zoom } from "./view.js";

const fits = document.querySelectorAll("[data-fit]");
const refitButton = document.getElementById("refit"); // a shared page has none
const shows = document.querySelectorAll("[data-show]");

/** Let the buttons say which view is seen. */
export function pressed() {
  if (refitButton) refitButton.hidden = view.fit !== null;
  for (const button of fits) button.setAttribute("aria-pressed", String(button.dataset.fit === view.fit));
}

function toggle(button) {
  const on = button.getAttribute("aria-pressed") !== "true";
  button.setAttribute("aria-pressed", String(on));
  if (button.dataset.show === "true") return drawTrue(on);
  shown[button.dataset.show] = on;
  button.dataset.show === "slice" ? touch() : invalidate();
}

for (const button of fits) button.addEventListener("click", () => (fit(button.dataset.fit), pressed()));
refitButton?.addEventListener("click", () => (refit(), pressed()));
for (const button of shows) button.addEventListener("click", () => toggle(button));
for (const button of document.querySelectorAll("[data-zoom]")) {
  button.addEventListener("click", () => (zoom(button.dataset.zoom === "in" ? 1.25 : 0.8), pressed()));
}

listen("scene", ({ measured, band, slice }) => {
  const there = { measured: measured !== null, errors: measured !== null, band, slice, plan: false, reach: false };
  for (const button of shows) button.hidden = there[button.dataset.show] === false;
});
const showBand = () => { // a fit or an estimate on the page has a band, too
  for (const button of shows) if (button.dataset.show === "band") button.hidden = false;
};
listen("ridge", showBand);
listen("tracking", ({ readings }) => readings && showBand());
listen("aimed", () => {
  for (const button of shows) {
    if (button.dataset.show === "plan") button.hidden = aim.plan === null;
    if (button.dataset.show === "reach") button.hidden = aim.reach === null;
  }
});
listen("redraw", pressed);
listen("state", () => now.state && pressed());
