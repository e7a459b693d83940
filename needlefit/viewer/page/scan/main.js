/** The page of a scan: its state, its tools, and what follows from a click. */

import { part, press } from "../dom.js";
import { showFault, showLists, showSaved, showVerdict, showWaiting } from "./panel.js";
import { post } from "../requests.js";
import { Views } from "./views.js";

const ask = async (name, content = {}) => (await post(`/scan/${name}`, content)).json();
const NOTHING = { needle: null, points: null, balls: null, contact: null, tip: null, ball_mm: null };
const SAME_BALL_MM = 2;
const KEYS = { l: "look", n: "needle", p: "points", e: "contact", t: "tip", b: "ball" };
const [TOOLS, WINDOWS] = ["tool", "window"].map((kind) => [...document.querySelectorAll(`[data-${kind}]`)]);

const state = {
  found: null,
  corrections: { ...NOTHING }, // as they stand on the page
  history: [],
  applied: JSON.stringify(NOTHING), // those that the program has used
  refused: "", // those that it refused
  tool: "look",
  shade: "tissue",
  cursor: null,
  busy: true,
  isRefused: () => JSON.stringify(state.corrections) === state.refused,
  window: () => state.found.windows[state.shade],
  place: (kind) => state.corrections[kind] ?? state.found[kind]?.at ?? null,
  balls: () => state.corrections.balls?.map((at) => ({ ...nearBall(at), at })) ?? state.found.balls,
};
const HINTS = {
  look: "Click a slice: the others go through that point.",
  needle: "Click the bright tube that is the needle.",
  points: "Click three or more points on the needle, from end to end: it is followed along them.",
  contact: "Click where the needle enters the tissue, best in the slice along the needle.",
  tip: "Click where the needle ends, best in the slice along the needle.",
  ball: "Click the centre of a marker ball; Remove in the list deletes one.",
};
const views = new Views(part("views"), state, { use, look });
const act = {
  look, correct,
  add: (balls) => correct({ balls: [...places(), ...balls] }),
  remove: (n) => correct({ balls: places().toSpliced(n, 1) }),
};
const places = () => state.balls().map((one) => one.at);

/** What was found of a ball that was placed at `at`: the program moves it to the ball that it sees there. */
function nearBall(at) {
  return state.found.balls.find((one) => Math.hypot(...one.at.map((x, n) => x - at[n])) < SAME_BALL_MM) ?? {};
}

function use(place) {
  const { tool } = state;
  if (tool === "look") look(place);
  else if (state.busy) return;
  else if (tool === "ball") act.add([place]);
  else if (tool === "points") correct({ points: [...(state.corrections.points ?? []), place], needle: null });
  else correct(tool === "needle" ? { needle: place, points: null } : { [tool]: place });
}

function look(place) {
  state.cursor = place;
  views.show(place);
  hint();
}

/** Say what a click does, and where the crosshair is. */
function hint() {
  const at = state.cursor ? ` Crosshair: ${state.cursor.map((x, n) => `${"LPS"[n]} ${x.toFixed(1)}`).join(", ")} mm.` : "";
  part("hint").textContent = HINTS[state.tool] + at;
}

function correct(change) {
  state.history.push(state.corrections);
  state.corrections = { ...state.corrections, ...change };
  showVerdict(state);
  refresh();
}

function undo() {
  if (!state.history.length || state.busy) return;
  state.corrections = state.history.pop();
  showVerdict(state);
  refresh();
}

const isNew = () => JSON.stringify(state.corrections) !== state.applied;

function refresh() {
  const corrected = Object.values(state.corrections).some((one) => one !== null);
  const can = { undo: state.history.length, clear: corrected, again: isNew() && !state.isRefused(), save: !isNew() && corrected };
  for (const [id, does] of Object.entries(can)) part(id).disabled = state.busy || !does;
  part("again").classList.toggle("on", !part("again").disabled);
  forbid("contact", state.found.entry_stated && "The table of scans states the entry (entry_x_mm ...)");
  forbid("ball", !state.found.has_markers && "The scan has no known places of markers: start the page with --markers");
  showLists(state, act);
  showWaiting(!state.busy && isNew() && !state.isRefused());
  if (part("ball-mm") !== document.activeElement) part("ball-mm").value = state.corrections.ball_mm ?? state.found.ball_mm;
  views.draw();
}

const find = (tool) => TOOLS.find((one) => one.dataset.tool === tool);

/** Switch a tool off, with the reason; `false`: it may be used. */
function forbid(tool, reason) {
  const one = find(tool);
  one.dataset.title ??= one.title;
  one.disabled = Boolean(reason);
  one.title = reason || one.dataset.title;
}

/** Show what was found; corrections that were refused stay on the page beside the former result. */
function take(found) {
  const refused = found.refusal && state.found ? JSON.stringify(state.corrections) : "";
  const used = { ...NOTHING, ...found.corrections };
  const again = !refused;
  if (again) state.corrections = used;
  Object.assign(state, { found, refused, applied: JSON.stringify(used) });
  part("title").textContent = found.id;
  part("where").textContent = found.volume;
  part("synthetic").hidden = !found.synthetic;
  document.title = `${found.id} – needlefit view`;
  showVerdict(state);
  if (again) views.make();
  refresh();
}

async function run(work, failed) {
  state.busy = true;
  if (state.found) refresh();
  try {
    await work();
  } catch (reason) {
    showFault(reason instanceof Error ? { what: reason.message } : reason, failed);
  } finally {
    state.busy = false;
    if (state.found) refresh();
  }
}

function again() {
  part("verdict").classList.remove("refused");
  part("verdict").textContent = "Reconstructing again …";
  return run(async () => take(await ask("again", state.corrections)), "Not used");
}

function choose(tool) {
  if (find(tool).disabled) return;
  state.tool = tool;
  hint();
  for (const one of TOOLS) one.ariaPressed = String(one.dataset.tool === tool);
}

for (const one of TOOLS) press(one, () => choose(one.dataset.tool));
for (const one of WINDOWS) {
  press(one, () => {
    state.shade = one.dataset.window;
    for (const other of WINDOWS) other.ariaPressed = String(other === one);
    views.load();
  });
}
part("ball-mm").addEventListener("change", ({ target }) => {
  if (target.checkValidity() && target.value) correct({ ball_mm: target.valueAsNumber });
});
press("undo", undo);
press("clear", () => correct({ ...NOTHING }));
press("again", again);
press("save", () => run(async () => showSaved(state, await ask("save", state.corrections)), "Not saved"));
addEventListener("keydown", (event) => {
  if (event.target.matches("input:not([type=range])")) return;
  if ((event.ctrlKey || event.metaKey) && event.key === "z") undo();
  else if (!event.ctrlKey && !event.metaKey && !event.altKey && KEYS[event.key]) choose(KEYS[event.key]);
});
addEventListener("beforeunload", (event) => state.found && isNew() && event.preventDefault());
addEventListener("resize", () => state.found && views.draw());

hint();
run(async () => {
  take(await ask("describe"));
  if (!state.found.examined) take(await ask("again"));
}, "Not shown");
