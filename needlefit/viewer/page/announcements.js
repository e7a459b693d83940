/** What is said to who listens to the page, and does not see it. */

const said = document.getElementById("said");

/** Say something now, also where it is what was said before. */
export function say(words) {
  said.textContent = "";
  requestAnimationFrame(() => (said.textContent = words));
}
