/** What the reader must know at once: refused inputs, and a line that is down. */

import { element, part, press, write } from "./dom.js";
import { open } from "./connection.js";
import { listen, now } from "./store.js";

const LASTS = 9000; // ms
const refusal = part("refusal");
const banner = part("banner");
const act = part("banner-act");
let fading = 0;

/** Say what was refused and how to fix it, until it is read. */
function refuse({ what, expected, fix }) {
  const parts = [what, expected && `Expected: ${expected}.`, fix && `To fix it: ${fix}.`].filter(Boolean);
  refusal.replaceChildren(...parts.map((part, i) => element(i ? "span" : "strong", {}, part)));
  clearTimeout(fading);
  fading = setTimeout(() => refusal.replaceChildren(), LASTS);
}

const soon = (wait) => (wait < 1 ? "at once" : `in ${wait.toFixed(0)} s`);

/** The text without a connection, and that of its button. */
const BANNERS = {
  lost: ({ wait }) => [
    `Not connected to the needle. Trying again ${soon(wait)}; until then inputs are not sent.`, "Try now",
  ],
  bye: ({ what }) => [
    `The program has stopped${what ? `: ${what}` : ""}. Its recording is kept. The page looks for it still.`,
    "Try now",
  ],
  stranger: () => [
    "The program does not know this page's token. Open the address as it was printed when it began.", "Try again",
  ],
  taken: () => ["This needle is held by another window. Inputs here are not sent.", "Take it back"],
};

listen("line", (line) => {
  banner.hidden = line.open;
  document.body.classList.toggle("offline", !line.open);
  if (line.open) return;
  const [words, button] = BANNERS[line.why](line);
  write("banner-text", words);
  act.textContent = button;
  act.hidden = false;
});
for (const kind of ["refused", "ended", "notice"]) listen(kind, refuse);
listen("accepted", () => refusal.replaceChildren()); // something later was carried out: an input, a reset
addEventListener("input", ({ target }) => target.type === "number" && refusal.replaceChildren()); // or is about to be
listen("unsent", () => refuse({ what: "Not sent: there is no line to the needle." }));
press(refusal, () => refusal.replaceChildren());
press(act, () => !now.connected && open());
