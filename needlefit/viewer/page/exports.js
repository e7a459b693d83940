/** What can be saved: asked of the server, kept by the browser. */

import { needle, token } from "./connection.js";
import { listen, now } from "./store.js";

const FILES = {
  "inputs.csv": "inputs, CSV", "shape.csv": "shape, CSV", "shape.mrk.json": "shape, Slicer markups",
  "picture.svg": "picture, SVG", "picture.png": "picture, PNG", "animation.gif": "animation, GIF",
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

async function ask(file) {
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
