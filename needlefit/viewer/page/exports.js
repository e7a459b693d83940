/** What can be saved: files of the server, and pictures as they are shown. */

import { needle, settle } from "./connection.js";
import { button, element, part } from "./dom.js";
import { paintOn, size } from "./drawing.js";
import { encodeGif } from "./gif.js";
import { post } from "./requests.js";
import { listen, now } from "./store.js";
import { SvgContext } from "./svg.js";

const FILES = {
  "inputs.csv": "inputs, CSV", "shape.csv": "shape, CSV", "shape.mrk.json": "shape, Slicer markups",
  "picture.svg": "picture, SVG", "picture.png": "picture, PNG", "animation.gif": "animation, GIF",
  "share.html": "share, one HTML file",
};
const [group, note] = [part("exports"), part("export-note")];

async function save(file, pressed) {
  pressed.ariaBusy = "true";
  pressed.disabled = true;
  note.classList.remove("bad");
  note.textContent = `Making ${file} …`;
  try {
    const blob = await (MADE_HERE[file] ?? ask)(file);
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

/** The picture as it is seen. */
function takePicture() {
  const canvas = draw(devicePixelRatio);
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

function takeSvg() {
  const context = new SvgContext();
  paintOn(context);
  return new Blob([context.write(...size())], { type: "image/svg+xml" });
}

/** A canvas with the picture, by default as it is seen now. */
function draw(scale, seen) {
  const canvas = element("canvas");
  [canvas.width, canvas.height] = size().map((one) => Math.round(one * scale));
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.setTransform(scale, 0, 0, scale, 0, 0);
  paintOn(context, seen);
  return canvas;
}

const FRAMES = { kept: 80, apart: 80, longest: 1, last: 1.5 }; // ms between two that are kept; seen at most, and the last one, s
let frames = []; // what was seen: {at (ms), state, band}

listen("scene", () => (frames = []));
listen("state", (state) => {
  const at = performance.now();
  if (frames.length > 1 && at - frames.at(-2).at < FRAMES.apart) frames.pop();
  frames.push({ at, state, band: now.band });
  if (frames.length > FRAMES.kept) frames = frames.filter((_, i) => i % 2 === 0 || i === FRAMES.kept);
});
listen("band", (band) => {
  const [last] = frames.slice(-1);
  if (last?.state.step === band.step) last.band = now.band;
});

/** What was seen, in the present view: the insertion at its own speed, without longer pauses. */
async function takeAnimation() {
  if (frames.length < 2) return ask("animation.gif"); // of a page that was loaded again the server has the recording
  const pictures = frames.map((one) => {
    const canvas = draw(1, one);
    return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  });
  const seconds = frames.map(({ at }, i) => (i + 1 < frames.length ? Math.min((frames[i + 1].at - at) / 1000, FRAMES.longest) : FRAMES.last));
  return encodeGif(pictures, seconds);
}

const MADE_HERE = { "picture.png": takePicture, "picture.svg": takeSvg, "animation.gif": takeAnimation };
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
  for (const one of group.children) one.disabled = !open || one.hasAttribute("aria-busy");
});
