/** What the reader must know at once: refused inputs, and a line that is down. */

import { element, part, press, write } from "./dom.js";
import { listen } from "./store.js";

const LASTS = 9000; // ms
const refusal = part("refusal");
const banner = part("banner");
const act = part("banner-act");
let fading = 0;

/** Say what was refused and how to fix it, until it is read. */
function refuse({ what, expected = "", fix = "" }) {
  const parts = [what, expected && `Expected: ${expected}.`, fix && `To fix it: ${fix}.`].filter(Boolean);
  refusal.replaceChildren(...parts.map((part, i) => element(i ? "span" : "strong", {}, part)));
  clearTimeout(fading);
  fading = setTimeout(() => refusal.replaceChildren(), LASTS);
}

/** The text without a connection, and that of the button that loads the page again. */
const BANNERS = {
  lost: () => ["Not connected to the needle: inputs are not recorded. Its recording so far is kept.", "Load again"],
  bye: ({ what }) => [`The program has stopped${what ? `: ${what}` : ""}. Its recording is kept.`, ""],
  stranger: () => ["The program does not know this page's token. Open the address as it was printed when it began.", ""],
  taken: () => ["This needle is held by another window. Inputs here are not sent.", "Take it back"],
};

listen("line", (line) => {
  banner.hidden = line.open;
  document.body.classList.toggle("offline", !line.open);
  if (line.open) return;
  const [words, button] = BANNERS[line.why](line);
  write("banner-text", words);
  act.textContent = button;
  act.hidden = !button;
});
for (const kind of ["refused", "ended", "notice"]) listen(kind, refuse);
listen("accepted", () => refusal.replaceChildren()); // something later was carried out: an input, a reset
addEventListener("input", (/** @type {any} */ { target }) => target.type === "number" && refusal.replaceChildren()); // or is about to be
listen("unsent", () => refuse({ what: "Not sent: there is no line to the needle." }));
press(refusal, () => refusal.replaceChildren());
press(act, () => location.reload());
