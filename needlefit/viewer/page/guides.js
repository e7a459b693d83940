/** The list of guides: where each stands, whether the needle turns freely in it, and how to take it away. */

import { addGuide } from "./actions.js";
import { makeField, show } from "./fields.js";
import { numbered } from "./names.js";
import { degrees, slope } from "./numbers.js";
import { change, wanted } from "./steering.js";
import { listen, now } from "./store.js";

const list = document.getElementById("guides");
const none = document.getElementById("no-guides");
const template = document.getElementById("guide-template");
const rows = new Map(); // by number

function makeRow({ item, name: called = numbered(item) }) {
  const part = template.content.firstElementChild.cloneNode(true);
  const [free, remove, fields] = [".free", ".remove", ".fields"].map((one) => part.querySelector(one));
  part.querySelector("strong").textContent = called;
  remove.setAttribute("aria-label", `Remove ${called}`);
  free.setAttribute("aria-label", `Needle turns freely in ${called}`);
  const field = (name, unit, digits, input, meant = (x) => x) => makeField(fields, {
    of: called, name, symbol: "guide", unit, step: 0.1, write: (value) => value.toFixed(digits),
    ask: (value, how) => change([[input, item, meant(value)]], how),
  });
  const row = {
    part, free, x: field("x", "mm", 2, "guide_x_mm"), y: field("y", "mm", 3, "guide_y_mm"),
    slope: field("slope", "°", 2, "guide_slope", slope),
  };
  remove.addEventListener("click", () => take(item));
  free.addEventListener("click", () => {
    change([["guide_turns_freely", item, free.getAttribute("aria-pressed") === "true" ? 0 : 1]]);
  });
  return row;
}

function take(item) {
  change([["guide_engaged", item, 0]]);
  document.getElementById("add-guide").focus(); // its own button is about to go
}

/** Let the list say which guides there are, and where. */
export function refresh() {
  const { guides } = now.state;
  for (const [item, { part }] of rows) {
    if (guides.some((guide) => guide.item === item)) continue;
    part.remove();
    rows.delete(item);
  }
  for (const guide of guides) refreshRow(guide);
  none.hidden = guides.length > 0;
}

function refreshRow(guide) {
  const { item, x, y, slope: along, turns_freely: free } = guide;
  if (!rows.has(item)) {
    rows.set(item, makeRow(guide));
    list.append(rows.get(item).part);
  }
  const row = rows.get(item);
  show(row.x, wanted("guide_x_mm", item, x));
  show(row.y, wanted("guide_y_mm", item, y));
  show(row.slope, degrees(wanted("guide_slope", item, along ?? 0)));
  row.slope.part.hidden = free;
  row.free.setAttribute("aria-pressed", String(free));
}

document.getElementById("add-guide").addEventListener("click", () => now.state && addGuide());
listen("scene", () => {
  rows.clear();
  list.replaceChildren();
});
