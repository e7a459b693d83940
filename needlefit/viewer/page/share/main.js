/** A shared recording: plays its states, which the file holds. */

import { part } from "../dom.js";
import { paint } from "../drawing.js";
import { degrees, signed, strengthOf } from "../quantities.js";
import { fillReadouts, refresh, refreshDescription } from "../readouts.js";
import { now, take } from "../store.js";
import "../toolbar.js";

const SHORTEST = 2; // s that a recording lasts at least while it is played
const { scene, states, needlefit } = JSON.parse(part("data").textContent);
const [slider, button] = [part("scrub"), part("play")];
let [at, playing, fresh, last, clock] = [0, false, true, null, 0];

const ends = states.at(-1)[0].time_s;
const pace = Math.max(1, ends / 20, 1e-9); // a long recording is played within 20 s
const lasts = Math.max(ends / pace, SHORTEST);
const timeOf = (index) => (ends > 0 ? (states[index][0].time_s / ends) * lasts : (index / states.length) * lasts);

/** What is put in at a state. */
const { symbol, unit } = strengthOf(scene.fitted);
const writeInputs = fillReadouts(part("inputs"), [
  ["bevel", "", ({ bevel }) => (bevel.side > 0 ? "▲ to +y" : "▼ to −y")],
  [symbol, unit, ({ bevel }) => strengthOf(bevel).value.toFixed(strengthOf(bevel).digits)],
  ["base y", "mm", ({ base }) => signed(base.input_y, 2)],
  ["base slope", "°", ({ base }) => signed(degrees(base.input_slope), 2)],
  ["guides", "", ({ guides }) => String(guides.length)],
]);

function showState(index) {
  at = index;
  const [state, band] = states[index];
  take(state);
  take(band ?? { kind: "band", x: [] });
  slider.value = index;
  slider.ariaValueText = `${state.time_s.toFixed(1)} s, ${state.depth_mm.toFixed(1)} mm deep`;
  part("time").textContent = `${state.time_s.toFixed(1)} s of ${ends.toFixed(1)} s`;
  writeInputs(state);
  refresh();
  refreshDescription();
  fresh = true;
}

function play(on) {
  playing = on;
  if (on && at === states.length - 1) showState(0);
  clock = timeOf(at);
  last = null;
  button.textContent = on ? "Pause" : "Play";
}

function advance(t) {
  clock += last === null ? 0 : (t - last) / 1000;
  last = t;
  let next = at;
  while (next < states.length - 1 && timeOf(next + 1) <= clock) next += 1;
  if (next !== at) showState(next);
  if (at === states.length - 1) play(false);
}

function frame(t) {
  if (playing) advance(t);
  paint(fresh);
  fresh = false;
  requestAnimationFrame(frame);
}

button.addEventListener("click", () => play(!playing));
slider.max = states.length - 1;
slider.addEventListener("input", () => {
  play(false);
  showState(Number(slider.value));
});
part("version").textContent = `Recorded with needlefit ${needlefit}, an interactive simulation of needles in soft tissue.`;
part("note").textContent = scene.note;
part("synthetic").hidden = !scene.synthetic;
take({ ...scene, kind: "scene" });
showState(states.length - 1);
requestAnimationFrame(frame);
now.shared = { show: showState, count: states.length }; // for whoever measures the page
if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
