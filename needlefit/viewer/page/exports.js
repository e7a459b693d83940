/** What can be saved: files that the program makes of the recording. */

import { needle, settle } from "./connection.js";
import { button, hand, part } from "./dom.js";
import { post } from "./requests.js";
import { listen, now } from "./store.js";

const FILES = {
  "inputs.csv": "inputs, CSV", "shape.csv": "shape, CSV", "shape.mrk.json": "shape, Slicer markups",
  "picture.svg": "figure, SVG", "picture.pdf": "figure, PDF", "picture.png": "figure, PNG", "share.html": "share, one HTML file",
};
const [group, note] = [part("exports"), part("export-note")];

async function save(file, pressed) {
  pressed.ariaBusy = "true";
  pressed.disabled = true;
  note.classList.remove("bad");
  note.textContent = `Making ${file} …`;
  try {
    const name = `${(now.scene?.recording ?? "needle").replace(/\.csv$/, "")}.${file}`;
    hand(await ask(file), name);
    note.textContent = `Saved ${name}.`;
  } catch ({ what, expected, fix }) {
    note.classList.add("bad");
    note.textContent = `${file} was not made: ${[what, expected && `expected ${expected}`, fix].filter(Boolean).join("; ")}`;
  } finally {
    pressed.ariaBusy = null;
    pressed.disabled = !now.connected;
  }
}

async function ask(file) {
  await settle();
  return (await post(`/export/${file}`, { needle: needle() })).blob();
}

for (const [file, called] of Object.entries(FILES)) {
  const made = button(called, () => save(file, made), { disabled: true });
  made.dataset.file = file;
  group.append(made);
}

listen("line", ({ open }) => {
  for (const one of group.querySelectorAll("[data-file]")) one.disabled = !open || one.hasAttribute("aria-busy");
});
