/** Which keys the control that has the focus needs for itself; the page's own keys keep away from these. */

const MOVES = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];
const FINDS = /^[\p{L}\p{N} _./-]$/u; // what finds an entry of a list as it is typed

const typed = new WeakSet(); // fields with something typed that does not count yet
addEventListener("input", ({ target }) => typed.add(target), true);
for (const kind of ["change", "focusout"]) addEventListener(kind, ({ target }) => typed.delete(target), true);

/** Whether a key belongs to what has the focus: a slider's arrows, a list's letters, all that is typed. */
export function belongs({ target, key, ctrlKey, metaKey }) {
  const command = ctrlKey || metaKey;
  if (target.matches("input[type=range]")) return !command && MOVES.includes(key);
  if (target.matches("select")) return !command && (MOVES.includes(key) || FINDS.test(key));
  if (target.closest("button, summary")) return key === " "; // it presses that
  if (command && ["z", "y"].includes(key.toLowerCase()) && target.matches("input") && !typed.has(target)) return false;
  return target.matches("input, textarea");
}
