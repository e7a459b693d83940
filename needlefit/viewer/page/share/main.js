/** A file that computes: the needles of a report, or one recorded insertion, steered by who reads it. */

import "../above.js";
import { computeBands } from "../bands.js";
import { element, hand, isDark, part, press, say, write } from "../dom.js";
import { further, invalidate, paint } from "../drawing.js";
import { handleAt } from "../handles.js";
import { ModelError, turnOver } from "../model/inputs.js";
import { describeState } from "../model/state.js";
import { between, line, palette } from "../painters/strokes.js";
import { place } from "../pointers.js";
import { counted, predictionOf, writeError } from "../quantities.js";
import { refresh } from "../readouts.js";
import { offerScenes } from "../scenes.js";
import { listen, now, publish, take } from "../store.js";
import { draw as drawStrip } from "../strip.js";
import { toggle } from "../toolbar.js";
import { fit } from "../view.js";
import { nameIn, readAddress, SAME, settle, writeAddress, writeRecording } from "./address.js";
import { buildFields, refreshFields } from "./controls.js";
import { begin, insert, load, prove, Replay } from "./needles.js";

const SHORTEST = 2, LONGEST = 20; // s that a recording lasts while it is played

let data = null;
let needle = null; // the one that is shown: {scene, recording or methods}
let steered = null;
let replay = null;
let steps = 0; // of all needles together
let frame = 0;
let fresh = false;
const shownMethods = new Set();
const refusal = part("refusal");

/** Show what the needle is now. */
function update() {
  steps += 1;
  take({ ...describeState(steered), step: steps, kind: "state" });
  fresh = true;
  redraw();
  refresh();
  refreshFields();
  refreshMethods();
  drawStrip();
}

function redraw() {
  frame ||= requestAnimationFrame(() => {
    frame = 0;
    paint(fresh);
    fresh = false;
    publish("drawn");
  });
}

/** Carry out lists of changes; what the model does not take is stated below a part, and the needle stays there, or if `whole` as it was. */
function rebuild(lists, below = part("flip").parentElement, whole = false) {
  if (replay) play(false);
  write(refusal, "");
  const { number } = steered;
  if (whole) steered.keep();
  try {
    for (const changes of lists) steered.apply(changes.map(([name, item, value]) => [name, item, value + 0]), { validOnly: false }); // a file has no -0
    settle(steered);
  } catch (error) {
    refuse(error, below);
    if (whole && steered.number > number) steered.apply([["return_to", null, number]]);
    if (steered.number === number) return refreshFields();
  }
  if (replay) replay.changed = true;
  part("back").disabled = false;
  update();
}

function refuse(error, below) {
  if (!error.what) throw error;
  below.after(refusal);
  write(refusal, `${error.what}. Expected: ${error.expected}.`);
}

const change = (changes, below) => rebuild([changes], below);

/** Show the needle of the address; returns whether it has one. The place of another part of a report is none. */
async function followAddress() {
  const address = location.hash.slice(1);
  if (!address || part(decodeURIComponent(address))) return false;
  const below = part("proof").parentElement;
  try {
    const name = nameIn(address);
    const number = data.needles.findIndex((one) => nameOf(one) === name);
    if (name !== null && number < 0) throw new ModelError(`the address has needle=${name}`, data.needles.map(nameOf).join(", "));
    if (number >= 0 && data.needles[number] !== needle) {
      part("needle-choice").value = number;
      await choose(number);
    }
    const lists = readAddress(address, needle.scene);
    if (lists.length) rebuild(lists, below, true);
    return lists.length > 0;
  } catch (error) {
    refuse(error, below);
    return true;
  }
}

const nameOf = ({ name, scene }) => name ?? scene.measured?.id ?? scene.title;

/** Copy the address of this file with the needle as it stands; of a needle that no address leads to, offer its recording. */
async function copyLink() {
  const name = data.needles.length > 1 ? nameOf(needle) : null;
  const { address, lost } = await writeAddress(data.kernel, steered, name);
  part("save-recording").hidden = !lost;
  write("link-note", lost ? `No link: an address does not carry ${lost.join(", ")}. A recording does.` : "");
  if (lost) return;
  rebuild(readAddress(address, needle.scene)); // the same needle within the solver's tolerance: from now on to the bit
  history.replaceState(null, "", `#${address}`); // no change of the needle
  await navigator.clipboard?.writeText(location.href).then(() => say("The link is copied."), () => null);
}

/** Save how the needle was moved, as `needlefit view --recording` opens it. */
function saveRecording() {
  const file = new Blob([writeRecording(needle.head, steered)], { type: "text/csv" });
  const name = `${nameOf(needle).replace(/[^\w-]+/g, "-")}.csv`;
  hand(file, name);
  write("link-note", `Saved ${name}. It opens with: needlefit view --recording ${name}`);
}

/** Show a needle as the file has it: of a recording its end, else the fit at the depth of the measured needle. */
async function choose(number) {
  const found = await begin(data.kernel, data.needles[number]);
  if (Number(part("needle-choice").value) !== number) return; // another one has been chosen meanwhile
  [needle, steered] = [data.needles[number], found];
  const { scene } = needle;
  replay = needle.recording ? new Replay(steered, needle.recording) : null;
  take({ ...scene, kind: "scene" });
  buildFields(needle, change);
  listMethods();
  const specimen = needle.new_specimen ? " of a specimen that was not fitted" : "";
  const draws = counted(scene.draws?.sets ?? 0, "posterior draw");
  write("band-note", scene.draws ? `Band: holds 95 % of the needles of ${draws}${specimen} wholly, without noise and model error.` : "");
  if (part("origin-mark")) write("origin-mark", scene.origin_mark);
  goBack();
}

function goBack() {
  write(refusal, "");
  write("link-note", "");
  part("save-recording").hidden = true;
  if (replay) return showStep(replay.steps.length);
  steered.rewind();
  insert(steered);
  part("back").disabled = true;
  update();
}

// ---- methods: the fit beside the baselines

const errorsOf = (values) => needle.scene.measured.metrics.map(([name, , unit]) => writeError(values?.[name] ?? null, unit));
const JUDGED = ["prediction"]; // the method that the verdict judges stands first
let present = []; // the cells of the needle's own errors

/** A colour of a line on paper, as it is on a dark page. */
const lighten = (colour) => between(colour, "#ffffff", 0.4);

function listMethods() {
  const { methods } = needle;
  part("methods").hidden = !methods;
  if (!methods) return;
  const heads = ["method", ...needle.scene.measured.metrics.map(([, label, unit]) => `${label} (${unit})`)];
  part("method-heads").replaceChildren(...heads.map((one) => element("th", { scope: "col" }, one)));
  const row = (name, values) => element("tr", {}, element("th", { scope: "row" }, name), values.map((one) => element("td", {}, one)));
  const first = row("", errorsOf(null));
  present = [...first.cells];
  const rows = methods.toSorted((one, other) => JUDGED.indexOf(other.key) - JUDGED.indexOf(one.key)).map((method) => {
    if (!method.x) return row(method.name, errorsOf(method.errors));
    const swatch = element("i", { className: "swatch line", ariaHidden: "true" });
    swatch.style.background = `light-dark(${method.colour}, ${lighten(method.colour)})`;
    const toggle = element("button", { type: "button", ariaPressed: String(shownMethods.has(method.key)) }, swatch, method.name);
    press(toggle, () => {
      const on = shownMethods.has(method.key);
      on ? shownMethods.delete(method.key) : shownMethods.add(method.key);
      toggle.ariaPressed = String(!on);
      invalidate();
    });
    return row(toggle, errorsOf(method.errors));
  });
  part("method-rows").replaceChildren(first, ...rows);
}

function refreshMethods() {
  if (!needle.methods) return;
  const { errors } = now.state;
  const upto = errors && !errors.whole ? `, first ${errors.upto_mm.toFixed(1)} mm` : "";
  const prediction = predictionOf(now.state, needle.scene);
  const called = prediction ? "drawn: our prediction" : `the needle above${upto}`;
  [called, ...errorsOf(prediction?.errors ?? errors)].forEach((text, i) => write(present[i], text));
}

further.push((context) => {
  for (const { key, x, y, colour } of needle?.methods ?? []) {
    if (!x || !shownMethods.has(key)) continue;
    line(context, x, y, palette.halo, 4);
    line(context, x, y, isDark() ? lighten(colour) : colour, 2);
  }
});

// ---- a recording

let playing = null; // {clock, last, n}: s of the recording, ms, steps carried out
const timeOf = (n) => (n ? replay.steps[n - 1][0] : 0);

function showStep(n, clock = timeOf(n)) {
  replay.to(n);
  write(refusal, "");
  part("scrub").value = n === replay.steps.length ? part("scrub").max : clock;
  part("scrub").ariaValueText = `${clock.toFixed(1)} s`;
  write("time", `${clock.toFixed(1)} s of ${timeOf(replay.steps.length).toFixed(1)} s`);
  part("back").disabled = true;
  update();
}

function play(on) {
  part("play").textContent = on ? "Pause" : "Play";
  if (!on) return void (playing = null);
  const n = replay.at === replay.steps.length || replay.changed ? 0 : replay.at;
  playing = { clock: timeOf(n), last: performance.now(), n };
  requestAnimationFrame(advance);
}

function advance(t) {
  if (!playing) return;
  const ends = Math.max(timeOf(replay.steps.length), 1e-9);
  playing.clock += ((t - playing.last) / 1000) * (ends / Math.min(Math.max(ends, SHORTEST), LONGEST));
  playing.last = t;
  while (playing.n < replay.steps.length && timeOf(playing.n + 1) <= playing.clock) playing.n += 1;
  showStep(playing.n, Math.min(playing.clock, ends));
  if (playing.n === replay.steps.length) return play(false);
  requestAnimationFrame(advance);
}

function buildRecording() {
  const { recording } = data.needles[0];
  part("transport").hidden = !recording;
  if (!recording) return;
  part("scrub").max = Math.ceil(10 * recording.at(-1)[0]) / 10; // the step is 0.1
  part("scrub").addEventListener("input", ({ target }) => {
    play(false);
    const clock = Math.min(Number(target.value), recording.at(-1)[0]);
    showStep(recording.filter(([time]) => time <= clock).length, clock);
  });
  press("play", () => play(!playing));
}

// ---- the file

/** State how what the file holds agrees with what this browser computes. */
async function stateAgreement() {
  const { count, largest } = await prove(data, SAME);
  const [what, of] = data.needles[0].recording ? ["recorded state", "recording"] : ["needle", "report"];
  const [agrees, place] = [largest < SAME, part("proof")];
  const found = largest === 0 ? `the same bytes as in the ${of}` : `up to ${largest.toExponential(1)} mm from the ${of}`;
  place.className = `quiet ${agrees ? "good" : "bad"}`;
  place.dataset.count = count;
  place.dataset.largest = largest;
  const checked = `Self-check ${agrees ? "passed" : "failed"}: ${counted(count, what)} computed here`;
  write("proof", `${checked}, ${Number.isNaN(largest) ? "one without a result" : found} (needlefit ${data.needlefit}).`);
}

async function start() {
  data = await load();
  const script = new Blob([part("program").textContent], { type: "text/javascript" });
  computeBands(new Worker(URL.createObjectURL(script)), data.kernel, () => ({ name: data.needles.indexOf(needle), steered }));
  const choice = part("needle-choice");
  choice.append(...data.needles.map((one, i) =>
    element("option", { value: String(i) }, [nameOf(one), one.group].filter(Boolean).join(", "))));
  part("choosing").hidden = data.needles.length < 2;
  choice.addEventListener("change", () => choose(Number(choice.value)));
  press("flip", () => change([turnOver(now.state.bevel.roll_deg)]));
  press("back", goBack);
  press("copy-link", copyLink);
  press("save-recording", saveRecording);
  part("canvas").addEventListener("touchstart", (event) => { // a finger on a handle drags it, beside handles it scrolls the page
    if (handleAt(...place(event.touches[0]), "touch")) event.preventDefault();
  }, { passive: false });
  addEventListener("hashchange", followAddress);
  offerScenes(rebuild, data.kernel);
  listen("redraw", redraw);
  listen("go to", (depth) => change([["depth_mm", null, depth]]));
  listen("steered", (set) => change(set));
  now.connected = true;
  buildRecording();
  if (!data.needles[0].recording) ["load", "points", "path", "errors", "strip"].forEach((name) => toggle(name, false)); // measured and fit come first
  await choose(0);
  const led = await followAddress();
  fit("tissue");
  await stateAgreement();
  if (!led && replay && !matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
}

const NEEDED = ["WebAssembly", "DecompressionStream", "Worker"]; // of a browser
start().catch((error) => {
  const lacking = NEEDED.filter((name) => !(name in globalThis));
  write("proof", lacking.length ? `This browser lacks ${lacking.join(", ")}: it cannot compute the needle.` : `The needle was not computed, for a fault in this file: ${error.message}`);
  part("proof").classList.add("bad");
  throw error;
});
