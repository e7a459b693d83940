/** What can be saved: files of the program; a picture, and a film, as they are seen: with legend and strip. */

import { needle, settle } from "./connection.js";
import { button, element, part } from "./dom.js";
import { paintOn, size } from "./drawing.js";
import { cross, palette, segments, setFont } from "./painters/strokes.js";
import { post } from "./requests.js";
import { listen, now } from "./store.js";
import { paintStrip } from "./strip.js";
import { listShown } from "./toolbar.js";

const FILES = {
  "inputs.csv": "inputs, CSV", "shape.csv": "shape, CSV", "shape.mrk.json": "shape, Slicer markups",
  "picture.svg": "figure, SVG", "picture.png": "picture, PNG", "share.html": "share, one HTML file",
};
const [group, note] = [part("exports"), part("export-note")];

async function save(file, pressed) {
  pressed.ariaBusy = "true";
  pressed.disabled = true;
  note.classList.remove("bad");
  note.textContent = `Making ${file} …`;
  try {
    hand(await (MADE_HERE[file] ?? ask)(file), file);
  } catch ({ what, expected, fix }) {
    note.classList.add("bad");
    note.textContent = `${file} was not made: ${[what, expected && `expected ${expected}`, fix].filter(Boolean).join("; ")}`;
  } finally {
    pressed.ariaBusy = null;
    pressed.disabled = !now.connected;
  }
}

/** Give a file to the reader. */
function hand(blob, file) {
  const name = `${(now.scene?.recording ?? "needle").replace(/\.csv$/, "")}.${file}`;
  const link = element("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  note.textContent = `Saved ${name}.`;
}

const LOOKS = { // samples of the legend: a colour, and the dash of a line, an area or a cross
  needle: ["needle", []], load: ["load", "area"], points: ["points", "cross"], path: ["path", []], measured: ["measured", [5, 3]],
  errors: ["gap", []], band: ["band", "area"], plan: ["plan", [6, 2]], pinned: ["ghost", [2, 3]], reach: ["reach", "area"],
};
const ROW = { height: 20, sample: 18, gap: 16 }; // px of the legend
const STRIP = 108; // px

/** The entries of the legend, from their left ends: [x, row, look, text]; they fill rows of the width, px. */
function layOutLegend(context, width) {
  const { title, synthetic } = now.scene;
  setFont(context, "plain", "left");
  let [x, row] = [8, 1];
  const entries = [["needle", "needle"], ...listShown()].filter(([name]) => name in LOOKS).map(([name, text]) => {
    const wide = ROW.sample + 6 + context.measureText(text).width;
    if (x > 8 && x + wide > width) [x, row] = [8, row + 1];
    x += wide + ROW.gap;
    return [x - wide - ROW.gap, row, LOOKS[name], text];
  });
  return [[8, 0, null, synthetic ? `${title} · synthetic data` : title], ...entries];
}

function paintEntry(context, x, y, look, text) {
  setFont(context, look ? "plain" : "strong", "left");
  context.fillStyle = palette.label;
  context.fillText(text, x + (look ? ROW.sample + 6 : 0), y);
  if (!look) return;
  const [colour, way] = [palette[look[0]], look[1]];
  if (way === "cross") return segments(context, cross(x + ROW.sample / 2, y, 4, true), colour, 1.5);
  if (way === "area") {
    context.fillStyle = `${colour}55`;
    context.fillRect(x, y - 5, ROW.sample, 10);
  }
  context.setLineDash(way === "area" ? [] : way);
  segments(context, [[[x, way === "area" ? y - 5 : y], [x + ROW.sample, way === "area" ? y - 5 : y]]], colour, 2);
  context.setLineDash([]);
}

/** Draw what is seen on a context that `make(width, height)` returns: the picture, its legend, and the strip unless it is hidden. */
function draw(make) {
  const [width, height] = size();
  const legend = layOutLegend(part("canvas").getContext("2d"), width);
  const below = height + ROW.height * (legend.at(-1)[1] + 1) + 8;
  const whole = below + (part("strip").hidden ? 0 : STRIP);
  const context = make(width, whole);
  paintOn(context);
  context.fillStyle = palette.gutter;
  context.fillRect(0, height, width, whole - height);
  for (const [x, row, look, text] of legend) paintEntry(context, x, height + 4 + ROW.height * (row + 0.5), look, text);
  if (whole > below) paintStrip(context, width, below, whole);
  return context;
}

/** A context of a canvas of its own, with as many pixels as the screen has. */
function onCanvas(width, height) {
  const scale = devicePixelRatio;
  const context = element("canvas", { width: Math.round(width * scale), height: Math.round(height * scale) }).getContext("2d");
  context.scale(scale, scale);
  return context;
}

const takePicture = () => new Promise((done) => draw(onCanvas).canvas.toBlob(done, "image/png"));

const MADE_HERE = { "picture.png": takePicture };
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

const FILMS = [["video/webm;codecs=vp9", "film.webm"], ["video/webm", "film.webm"], ["video/mp4", "film.mp4"]]; // VP8 leaves out pictures
const AT_END = 100; // ms from the last picture to the end of a film: it lasts until the button is pressed
const [mimeType, filmed] = FILMS.find(([type]) => globalThis.MediaRecorder?.isTypeSupported(type)) ?? [];
const filming = button("film", () => now.state && (film ? end() : begin()), { title: "Films the picture from one press to the next", ariaPressed: "false" });
let film = null; // {recorder, context}, while there is one; it keeps the size with which it begins

function begin() {
  const context = draw(onCanvas);
  const recorder = new MediaRecorder(context.canvas.captureStream(), { mimeType });
  recorder.onstart = show;
  recorder.ondataavailable = ({ data }) => hand(data, filmed); // once, at the end
  film = { recorder, context };
  filming.ariaPressed = "true";
  note.textContent = "Filming …";
  recorder.start();
}

const show = () => film && draw(() => film.context);

function end() {
  const { recorder } = film;
  show();
  film = null;
  filming.ariaPressed = "false";
  setTimeout(() => recorder.stop(), AT_END);
}

if (filmed) group.append(filming);
listen("drawn", show);
