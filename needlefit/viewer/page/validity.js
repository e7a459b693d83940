/** Where the needle is outside what the model assumes, words say so: beside the numbers, and once aloud. */

import { say } from "./announcements.js";
import { listen } from "./store.js";
import { toPy, view } from "./view.js";

let announced = false; // of this needle

/** Which limits of the model the needle exceeds, in words; empty where it exceeds none. */
export const exceeded = ({ faults }) => (faults?.length ? `outside the model: ${faults.join("; ")}` : "");

listen("scene", () => (announced = false));
listen("state", (state) => {
  const words = exceeded(state);
  const sentence = words && `${words[0].toUpperCase()}${words.slice(1)}. Shape and forces cannot be relied on.`;
  const beyond = document.getElementById("beyond");
  if (beyond.textContent !== sentence) beyond.textContent = sentence;
  beyond.classList.toggle("low", toPy(state.tip.y) < view.box.top + view.box.height / 2); // not on the tip
  if (announced || !exceeded(state)) return;
  announced = true;
  say(`The needle is ${exceeded(state)}.`);
});
