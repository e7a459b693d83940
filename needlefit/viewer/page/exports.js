/** What can be saved: files of the server, and the picture as it is shown. */

import { needle, token } from "./connection.js";
import { listen, now } from "./store.js";

const FILES = {
  "inputs.csv": "inputs, CSV", "shape.csv": "shape, CSV", "shape.mrk.json": "shape, Slicer markups",
  "picture.png": "picture, PNG", "animation.gif": "animation, GIF",
  "share.html": "share, one HTML file",
};
const group = document.getElementById("exports");
const note = document.getElementById("export-note");

async function save(file, button) {
  button.setAttribute("aria-busy", "true");
  button.disabled = true;
  note.classList.remove("bad");
  note.textContent = `Making ${file} …`;
  try {
    const { blob, name } = await ask(file);
    keep(blob, name);
    note.textContent = `Saved ${name}.`;
  } catch (error) {
    note.classList.add("bad");
    note.textContent = error.message;
  } finally {
    button.removeAttribute("aria-busy");
    button.disabled = !now.connected;
  }
}

/** The picture as it is shown, with its band and whatever else is drawn. */
async function picture() {
  const [background, foreground] = ["background", "canvas"].map((id) => document.getElementById(id));
  const both = Object.assign(document.createElement("canvas"), { width: background.width, height: background.height });
  const context = both.getContext("2d");
  for (const part of [background, foreground]) context.drawImage(part, 0, 0);
  return { blob: await new Promise((done) => both.toBlob(done, "image/png")), name: `${stem()}.picture.png` };
}

async function ask(file) {
  if (file === "picture.png") return picture();
  const answer = await fetch(`/export/${file}`, {
    method: "POST",
    headers: { Authorization: `Bearer ${token()}`, "Content-Type": "application/json" },
    body: JSON.stringify({ needle: needle() }),
  }).catch(() => {
    throw new Error(`${file} was not made: there is no line to the program.`);
  });
  if (!answer.ok) throw new Error(`${file} was not made: ${await reason(answer)}`);
  const given = /filename="?([^";]+)/.exec(answer.headers.get("Content-Disposition") ?? "");
  return { blob: await answer.blob(), name: given?.[1] ?? `${stem()}.${file}` };
}

async function reason(answer) {
  const body = await answer.text();
  try {
    const { what, expected, fix } = JSON.parse(body);
    return [what, expected && `expected ${expected}`, fix].filter(Boolean).join("; ");
  } catch {
    return body || answer.statusText;
  }
}

const stem = () => (now.scene?.recording ?? "needle").replace(/\.csv$/, "");

function keep(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

for (const [file, called] of Object.entries(FILES)) {
  const button = document.createElement("button");
  Object.assign(button, { type: "button", textContent: called, disabled: true });
  button.dataset.file = file;
  button.addEventListener("click", () => save(file, button));
  group.append(button);
}
listen("line", ({ open }) => {
  for (const button of group.children) button.disabled = !open || button.hasAttribute("aria-busy");
});
