/** The panel of target and plan: places, obstacles, the plan's probability, and a game against the planner. */

import { speed } from "./actions.js";
import { aim, moveTo, place, sendAfterGoal, setAim, tipError, touches } from "./aim.js";
import { say } from "./announcements.js";
import { makeField, show } from "./fields.js";
import { command } from "./steering.js";
import { listen, now } from "./store.js";

const part = (id) => document.getElementById(id);
const write = (id, text) => part(id).textContent === text || (part(id).textContent = text);
const asMm = (value) => value.toFixed(2);
const percent = (share) => (100 * share).toFixed(0);
let planning = false;
let fields = []; // [field, () => value]
let rows = -1; // obstacles that have fields

function field(into, of, name, current, ask) {
  const made = makeField(into, { of, name, unit: "mm", step: 0.1, write: asMm, ask });
  fields.push([made, current]);
}

/** Fields of the target and of each obstacle, made anew where their number changes. */
function build() {
  const shown = aim.target ? aim.obstacles.length : -2 - aim.obstacles.length;
  if (rows === shown) return;
  rows = shown;
  fields = [];
  part("target-fields").replaceChildren();
  part("obstacles").replaceChildren(...aim.obstacles.map(obstacleRow));
  if (!aim.target) return;
  const into = part("target-fields");
  field(into, "target", "x", () => aim.target[0], (x) => moveTo(null, x, aim.target[1]));
  field(into, "target", "y", () => aim.target[1], (y) => moveTo(null, aim.target[0], y));
  field(into, "target", "radius", () => aim.radius, (radius) => setAim({ radius: Math.max(radius, 0.05) }));
}

function obstacleRow(_, number) {
  const row = document.createElement("li");
  const head = Object.assign(document.createElement("div"), { className: "head" });
  const name = Object.assign(document.createElement("strong"), { textContent: `obstacle ${number + 1}` });
  const remove = Object.assign(document.createElement("button"), { type: "button", textContent: "Remove" });
  remove.setAttribute("aria-label", `Remove obstacle ${number + 1}`);
  remove.addEventListener("click", () => {
    setAim({ obstacles: aim.obstacles.filter((_, i) => i !== number) });
    part("put-obstacle").focus(); // its own button has gone
  });
  head.append(name, remove);
  row.append(head);
  ["x", "y", "radius"].forEach((name, at) => {
    const set = (value) => setAim({
      obstacles: aim.obstacles.map((one, i) => (i === number ? one.with(at, at === 2 ? Math.max(value, 0.05) : value) : one)),
    });
    field(row, `obstacle ${number + 1}`, name, () => aim.obstacles[number][at], set);
  });
  return row;
}

/** Let the panel say what is aimed at, and how probable the plan is. */
export function refresh() {
  if (!now.state) return;
  build();
  for (const [one, current] of fields) show(one, current());
  for (const [id, what] of [["put-target", "target"], ["put-obstacle", "obstacle"]]) {
    part(id).setAttribute("aria-pressed", String(aim.placing === what));
  }
  const ahead = aim.plan?.steps.some(([depth]) => depth > now.state.depth_mm + 1e-6) ?? false;
  part("make-plan").disabled = !aim.target || planning;
  part("run-plan").disabled = part("step-plan").disabled = !ahead;
  part("aim-clear").disabled = !aim.target && !aim.obstacles.length;
  write("aim-note", aim.placing ? `Click on the picture where the ${aim.placing} is.` : "");
  write("aim-error", aim.target ? `Tip to target: ${tipError(now.state).toFixed(2)} mm.` : "");
  write("plan-note", planning ? "Planning …" : describePlan());
  write("game-note", describeGame());
}

/** The plan in sentences, its probability first. */
function describePlan() {
  const { plan } = aim;
  if (!plan || aim.challenge?.hidden) return "";
  const turns = `${plan.turns} turn${plan.turns === 1 ? "" : "s"} of the bevel, base to ${plan.steps.at(-1)[2].toFixed(1)} mm.`;
  const nominal = plan.nominal_miss_mm === null ? "" : `This needle misses by ${plan.nominal_miss_mm.toFixed(2)} mm. `;
  if (plan.draws < 2) return `${nominal}${turns} Parameters are taken as exact.`;
  const near = Object.entries(plan.touched).filter(([, share]) => share > 0);
  const touched = near.map(([name, share]) => `${percent(share)} % touch ${name}. `).join("");
  return `Reaches the target with probability ${percent(plan.probability)} % (95 % CI ${percent(plan.low)} to `
    + `${percent(plan.high)} %, ${plan.draws} draws). ${touched}${nominal}${turns}`;
}

function describeGame() {
  const game = aim.challenge;
  if (!game) return "";
  if (!aim.target) return "Choosing a target …";
  if (game.hidden) return "Steer the tip into the target past the obstacle, then compare.";
  const planner = game.planner === null ? "the planner found no way" : `the planner ${game.planner.toFixed(2)} mm`;
  if (game.touched) return `You touch the obstacle, ${planner}: ${game.planner === null ? "nobody wins" : "the planner wins"}.`;
  const won = game.planner === null || game.hand < game.planner;
  return `You ${game.hand.toFixed(2)} mm, ${planner}: ${won ? "you win" : "the planner wins"}.`;
}

function ask() {
  planning = true;
  sendAfterGoal({ do: "plan" });
  refresh();
}

function challenge() {
  if (aim.challenge?.hidden && aim.target) { // done: compare
    Object.assign(aim.challenge, { hidden: false, hand: tipError(now.state), touched: touches(now.state) });
    say(describeGame());
  } else {
    command({ do: "challenge", radius: aim.radius });
    Object.assign(aim, { target: null, obstacles: [], plan: null, reach: null });
    aim.challenge = { hidden: true, hand: null, touched: false, planner: null };
  }
  part("challenge").textContent = aim.challenge.hidden ? "Compare with the planner" : "Beat the planner";
  refresh();
}

async function readFile(input) {
  const [file] = input.files;
  if (file) command({ do: "markups", name: file.name, text: await file.text(), obstacle_radius: aim.radius });
  input.value = "";
}

const PRESSED = {
  "put-target": () => place("target"),
  "put-obstacle": () => place("obstacle"),
  "aim-clear": () => setAim({ target: null, obstacles: [], reach: null }),
  "make-plan": ask,
  "run-plan": () => command({ do: "run", speed_mm_s: speed() }),
  "step-plan": () => command({ do: "run", speed_mm_s: speed(), one: true }),
  "open-markups": () => part("markups").click(),
  challenge,
};
for (const [id, press] of Object.entries(PRESSED)) part(id).addEventListener("click", () => now.state && press());
part("markups").addEventListener("change", ({ target }) => readFile(target));
listen("plan", (plan) => {
  planning = false;
  refresh();
  if (!plan.fault && !aim.challenge) say(describePlan());
});
listen("refused", () => (planning = false));
listen("aimed", () => {
  if (!aim.challenge) part("challenge").textContent = "Beat the planner";
  refresh();
});
