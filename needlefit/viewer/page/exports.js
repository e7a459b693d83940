/** What can be saved: files of the server, and the picture as it is shown. */

import { needle } from "./connection.js";
import { button, element, part } from "./dom.js";
import { post } from "./requests.js";
import { listen, now } from "./store.js";

const FILES = {
  "inputs.csv": "inputs, CSV", "shape.csv": "shape, CSV", "shape.mrk.json": "shape, Slicer markups",
  "picture.png": "picture, PNG", "animation.gif": "animation, GIF",
  "share.html": "share, one HTML file",
};
const [group, note] = [part("exports"), part("export-note")];

async function save(file, pressed) {
  pressed.ariaBusy = "true";
  pressed.disabled = true;
  note.classList.remove("bad");
  note.textContent = `Making ${file} …`;
  try {
    const blob = await (file === "picture.png" ? takePicture() : ask(file));
    const name = `${(now.scene?.recording ?? "needle").replace(/\.csv$/, "")}.${file}`;
    const link = element("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    note.textContent = `Saved ${name}.`;
  } catch ({ what, expected, fix }) {
    note.classList.add("bad");
    note.textContent = `${file} was not made: ${[what, expected && `expected ${expected}`, fix].filter(Boolean).join("; ")}`;
  } finally {
    pressed.ariaBusy = null;
    pressed.disabled = !now.connected;
  }
}

function takePicture() {
  const layers = [part("background"), part("canvas")];
  const both = element("canvas", { width: layers[0].width, height: layers[0].height });
  for (const layer of layers) both.getContext("2d").drawImage(layer, 0, 0);
  return new Promise((done) => both.toBlob(done, "image/png"));
}

const ask = async (file) => (await post(`/export/${file}`, { needle: needle() })).blob();

for (const [file, called] of Object.entries(FILES)) {
  const made = button(called, () => save(file, made), { disabled: true });
  made.dataset.file = file;
  group.append(made);
}
listen("line", ({ open }) => {
  for (const one of group.children) one.disabled = !open || one.hasAttribute("aria-busy");
});
