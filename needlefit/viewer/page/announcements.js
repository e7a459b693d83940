/** Announcements to screen readers. */

const announced = document.getElementById("announced");

/** Announce words now, also where they are those announced before. */
export function say(words) {
  announced.textContent = "";
  requestAnimationFrame(() => (announced.textContent = words));
}
