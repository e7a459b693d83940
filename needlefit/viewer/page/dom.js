/** Parts of the page: found, made and written. */

/** A part by its id, or itself. @type {(id: string | Element) => any} */
export const part = (id) => (typeof id === "string" ? document.getElementById(id) : id);

/** Write a text into a part, if it is another one. @param {string | Element} id @param {string} text */
export function write(id, text) {
  const place = part(id);
  if (place.textContent !== text) place.textContent = text;
}

/** Make an element with these properties (`ariaLabel` and the like among them) and contents. @param {string} tag @param {object} properties @param {(string | Node | (string | Node)[])[]} contents */
export function element(tag, properties = {}, ...contents) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...contents.flat());
  return made;
}

/** @param {string | Element} id @param {() => void} act */
export const press = (id, act) => part(id).addEventListener("click", act);

/** A term and what stands beside it in a list. @param {string | Node} term @param {string | Node | (string | Node)[]} value */
export const entry = (term, value) => element("div", {}, element("dt", {}, term), element("dd", {}, value));
