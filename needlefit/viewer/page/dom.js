/** Parts of the page: found, made and written. */

/** @type {(id: string) => any} */
export const part = (id) => document.getElementById(id);

/** Write a text into a part, if it is another one. @param {string | Element} id @param {string} text */
export function write(id, text) {
  const place = typeof id === "string" ? part(id) : id;
  if (place.textContent !== text) place.textContent = text;
}

/** Make an element with these properties (`ariaLabel` and the like among them) and contents. @param {string} tag @param {object} properties @param {(string | Node | (string | Node)[])[]} contents */
export function element(tag, properties = {}, ...contents) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...contents.flat());
  return made;
}

/** @param {string | Element} id @param {() => void} act */
export const press = (id, act) => (typeof id === "string" ? part(id) : id).addEventListener("click", act);

/** A term and what stands beside it in a list. @param {string | Node} term @param {string | Node | (string | Node)[]} value */
export const entry = (term, value) => element("div", {}, element("dt", {}, term), element("dd", {}, value));

/** Give the reader a file. @param {Blob} blob @param {string} name */
export function hand(blob, name) {
  const link = /** @type {HTMLAnchorElement} */ (element("a", { href: URL.createObjectURL(blob), download: name }));
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

const dark = matchMedia("(prefers-color-scheme: dark)");

/** Call `act` once the reader's colour scheme has changed. @param {() => void} act */
export const onScheme = (act) => dark.addEventListener("change", act);

/** What is drawn with on a canvas. @param {HTMLCanvasElement} canvas */
export const getContext = (canvas) => /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));

/** A colour of the style sheet: light-dark(one, other), or one for both; on paper the light one. @param {string} name @param {boolean} paper */
export function colour(name, paper) {
  const both = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).match(/#\w+/g) ?? [""];
  return both[dark.matches && !paper ? both.length - 1 : 0];
}
