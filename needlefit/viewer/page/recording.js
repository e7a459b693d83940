/** Recordings: of the file, saved or dropped on the page, and kept by the browser. */

import { writeRecording } from "./address.js";
import { part, press, write } from "./dom.js";
import { nameOf, save } from "./link.js";
import { ModelError } from "./model/inputs.js";
import { forgetPast, goHome, refuse, show } from "./steering.js";
import { listen, now } from "./store.js";
import { Replay } from "./stored.js";

const PAUSE = 400; // ms without a change, after which the browser keeps the needle
const MOST_KEPT = 1_000_000; // characters
const scrub = /** @type {HTMLInputElement} */ (part("scrub"));
const COLUMNS = "step,time_s,input,item,value,tip_lateral_mm";

/** Show a needle that was chosen as the file has it: of a recording its end. */
export function goBack() {
  write("link-note", "");
  part("back").disabled = true;
  if (now.replay) showPlace(now.replay, now.replay.places.at(-1) ?? 0);
  else goHome();
}

/** Show the needle of a recording where it is as far as a place. @param {Replay} replay @param {number} place */
function showPlace(replay, place) {
  const { places, unit } = replay;
  const end = places.at(-1) ?? 0;
  forgetPast();
  replay.to(places.filter((one) => one <= place).length);
  scrub.value = String(place >= end ? scrub.max : place);
  scrub.ariaValueText = `${place.toFixed(1)} ${unit}`;
  write("time", `${place.toFixed(1)} of ${end.toFixed(1)} ${unit}`);
  show();
}

/** Prepare the recording of a needle, or none; `planned`: the depth is dragged along it, which only increases. @param {RecordedStep[] | undefined} recording */
export function openRecording(recording, planned = false) {
  part("transport").hidden = !recording;
  now.replay = null;
  if (!recording) return;
  const places = recording.map(([time, changes]) => (planned ? changes.find(([name]) => name === "depth_mm")?.[2] ?? 0 : time));
  now.replay = new Replay(now.steered, recording, places, planned ? "mm of the plan" : "s of the recording");
  scrub.max = String(Math.ceil(10 * (places.at(-1) ?? 0)) / 10); // the step is 0.1
  scrub.ariaLabel = planned ? "depth along the plan, mm" : "time of the recording, s";
}

scrub.addEventListener("input", () => {
  const { replay } = now;
  if (replay) showPlace(replay, Math.min(Number(scrub.value), replay.places.at(-1) ?? 0));
});
press("back", () => {
  localStorage.removeItem(keyOf(now.needle));
  goBack();
});
listen("steers", () => {
  if (now.replay) now.replay.changed = true;
});

// ---- files

/** Save how the needle was moved, as `needlefit view --recording` opens it. */
press("save-recording", () => {
  const name = save(writeRecording(now.needle.head ?? "", now.steered), "text/csv", "csv");
  write("link-note", `Saved ${name}. It opens on this page, and with: needlefit view --recording ${name}`);
});

/** The head of a recording without its comment and the version that wrote it: the same for the same needle. @param {string} head */
const identify = (head) => head.split("\n").filter((one) => one.startsWith("#")).slice(1).filter((one) => !one.startsWith("# needlefit =")).join("\n");

/** The steps of a recording of one of the needles of this file, and the number of that. @param {string} text */
function readRecording(text) {
  const lines = text.split(/\r?\n/);
  const count = lines.findIndex((one) => !one.startsWith("#"));
  const number = now.data.needles.findIndex(({ head }) => head && identify(head) === identify(text));
  if (count < 1 || lines[count] !== COLUMNS) throw new ModelError("the file is no recording", "a file of Save recording, or of needlefit plan");
  if (number < 0) throw new ModelError("the recording is of another scene", "one of this page; needlefit view --recording opens others");
  const steps = /** @type {RecordedStep[]} */ ([]);
  for (const row of lines.slice(count + 1).filter(Boolean)) {
    const [step, time, name, item, value, tip] = row.split(",");
    if (Number(step) > steps.length) steps.push([Number(time), [], NaN]);
    const last = steps[steps.length - 1];
    last[1].push([name, item ? Number(item) : null, Number(value)]);
    if (tip) last[2] = Number(tip);
  }
  return { number, steps };
}

/** Open recordings that are dropped on the page; `choose(number)` shows another needle of the file. @param {(number: number) => Promise<void>} choose */
export function openDropped(choose) {
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", async (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer?.files ?? [];
    if (!file) return;
    try {
      const { number, steps } = readRecording(await file.text());
      await choose(number);
      openRecording(steps);
      goBack();
      write("link-note", `Opened ${file.name}.`);
    } catch (error) {
      refuse(error, part("proof").parentElement);
    }
  });
}

// ---- the needle that the browser keeps

/** @param {Needle} needle */
const keyOf = (needle) => `needlefit ${location.pathname} ${nameOf(needle)}`;
let keeping = 0;

/** Have the browser keep the needle that was steered, where it lets a page do so. */
function keep() {
  const { needle, steered } = now;
  const text = JSON.stringify({ head: needle.head, way: steered.listWay().map(({ changes }) => changes) });
  try {
    if (text.length <= MOST_KEPT) localStorage.setItem(keyOf(needle), text);
  } catch { /* there is no room: the needle is not kept */ }
}

listen("steers", () => {
  clearTimeout(keeping);
  keeping = setTimeout(keep, PAUSE);
});
addEventListener("pagehide", () => keeping && keep());

/** Show the needle as the reader left it; returns whether there was one. */
export function restore() {
  const { needle, steered, replay } = now;
  const kept = JSON.parse(localStorage.getItem(keyOf(needle)) ?? "null");
  if (!kept || kept.head !== needle.head) return false;
  steered.rewind();
  try {
    for (const changes of kept.way) steered.apply(changes);
  } catch {
    localStorage.removeItem(keyOf(needle));
    goBack();
    return false;
  }
  if (replay) replay.changed = true;
  part("back").disabled = false;
  write("link-note", "The needle as you left it: this browser keeps it.");
  show();
  return true;
}
