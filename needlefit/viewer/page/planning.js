/** The panel of target and plan: places, obstacles, and the plan's probability. */

import { speed } from "./actions.js";
import { aim, askPlan, nameOf, place, put, setAim, SMALLEST, tipError } from "./aim.js";
import { button, element, part, press, say, write } from "./dom.js";
import { makeField, show } from "./fields.js";
import { rollOf } from "./model/inputs.js";
import { counted, describeRoll } from "./quantities.js";
import { runPlan } from "./steering.js";
import { listen, now } from "./store.js";

const AHEAD = 10; // mm before the tip
const asMm = (value) => value.toFixed(2);
const percent = (share) => (100 * share).toFixed(0);
let fields = []; // [field, () => value]
let rows = null; // what has fields

/** Fields of a circle's x, y and radius; `get` returns them, `set` is given all three. */
function circleFields(into, symbol, of, get, set) {
  ["x", "y", "radius"].forEach((name, at) => {
    const ask = (value) => set(get().with(at, at === 2 ? Math.max(value, SMALLEST) : value));
    fields.push([makeField(into, { of, name, symbol, unit: "mm", step: 0.1, write: asMm, ask }), () => get()[at]]);
  });
}

/** Fields of the target and of each obstacle, made anew where their number changes. */
function build() {
  const shown = JSON.stringify([Boolean(aim.target), aim.obstacles.map((_, i) => nameOf(i))]);
  if (rows === shown) return;
  [rows, fields] = [shown, []];
  const into = part("target-fields");
  into.replaceChildren();
  part("obstacles").replaceChildren(...aim.obstacles.map(obstacleRow));
  if (!aim.target) return;
  into.append(element("strong", {}, "target"));
  circleFields(into, "target", "target", () => [...aim.target, aim.radius], ([x, y, radius]) => setAim({ target: [x, y], radius }));
}

function obstacleRow(_, number) {
  const name = nameOf(number);
  const remove = () => {
    setAim({ obstacles: aim.obstacles.filter((_, i) => i !== number) });
    part("put-obstacle").focus(); // its own button has gone
  };
  const head = [element("strong", {}, name), button("Remove", remove, { ariaLabel: `Remove ${name}` })];
  const row = element("li", {}, element("div", { className: "head" }, head));
  circleFields(row, "obstacle", name, () => aim.obstacles[number], (circle) => setAim({ obstacles: aim.obstacles.with(number, circle) }));
  return row;
}

/** Let the panel say what is aimed at, and how probable the plan is. */
export function refresh() {
  if (!now.state) return;
  build();
  for (const [one, current] of fields) show(one, current());
  for (const [id, what] of [["put-target", "target"], ["put-obstacle", "obstacle"]]) {
    part(id).ariaPressed = String(aim.placing === what);
  }
  const ahead = aim.plan?.path.some(({ depth }) => depth > now.state.depth_mm + 1e-6) || false;
  part("make-plan").disabled = !aim.target || aim.planning;
  part("run-plan").disabled = !ahead || aim.planning || aim.plan.left;
  part("aim-clear").disabled = !aim.target && !aim.obstacles.length;
  write("aim-note", aim.placing ? `Click on the picture where the ${aim.placing} is.` : "");
  write("aim-error", aim.target ? `Tip to target: ${tipError(now.state).toFixed(2)} mm.` : "");
  write("plan-note", aim.planning ? "Planning …" : describePlan());
}

/** The plan in sentences, its outcome first. */
function describePlan() {
  const { plan } = aim;
  if (!plan) return "";
  const [{ bevel }, { controls }] = [plan.path[0], plan.path.at(-1)];
  const rolled = bevel.roll ? `Bevel at ${describeRoll({ roll_deg: rollOf(bevel) })}, ` : "";
  const turns = `${rolled}${counted(plan.turns, "turn")} of the bevel, base to ${controls.baseY.toFixed(1)} mm.`;
  if (plan.left) return "The needle has left its plan. Plan again from where it stands.";
  const bound = [...plan.at_limit.map((one) => `The ${one} is at its limit`), ...plan.warnings].map((one) => ` ${one}.`).join("");
  return `${describeOutcome(plan)} ${turns}${bound}${plan.draws < 2 ? " Parameters are taken as exact." : ""}`;
}

/** Whether the plan reaches the target past the obstacles, or how the best one fails. */
function describeOutcome(plan) {
  const goal = `the target${aim.obstacles.length ? " and touches no obstacle" : ""}`;
  const near = Object.entries(plan.touched).filter(([, share]) => share > 0);
  const miss = plan.nominal_miss_mm;
  const ends = miss === null ? "With the parameters shown there is no needle within the model's limits."
    : `With the parameters shown the tip${plan.hits ? "" : " of the best one"} ends ${miss.toFixed(2)} mm from the target.`;
  const none = `No plan was found that reaches ${goal}.`;
  if (plan.draws < 2) {
    const touched = near.length ? ` The needle touches ${near.map(([name]) => name).join(", ")}.` : "";
    return plan.hits ? `The plan reaches ${goal}. ${ends}` : `${none} ${ends}${touched}`;
  }
  const touched = near.map(([name, share]) => `${percent(share)} % touch ${name}. `).join("");
  const chance = `${plan.hits ? "with probability" : "Probability"} ${percent(plan.probability)} % (95 % CI ${percent(plan.low)} to ${percent(plan.high)} %, ${plan.draws} draws). `;
  return `${plan.hits ? `Reaches ${goal} ` : `${none} `}${chance}${touched}${ends}`;
}

/** Wait for a click on the picture; a key puts it ahead of the tip at once, where its numbers can be changed. */
function placeBy(what, { detail }) {
  place(what);
  if (detail || aim.placing !== what) return;
  const { tip, depth_mm: depth } = now.state;
  const far = Math.max(now.scene.depth_mm, depth + AHEAD);
  put(what === "target" ? far : (depth + far) / 2, tip.y);
  refresh();
  part(what === "target" ? "target-fields" : "obstacles").querySelector(".number")?.focus();
}

const PRESSED = {
  "put-target": (event) => placeBy("target", event),
  "put-obstacle": (event) => placeBy("obstacle", event),
  "aim-clear": () => setAim({ target: null, obstacles: [] }),
  "make-plan": () => {
    askPlan();
    refresh();
  },
  "run-plan": () => runPlan(aim.plan, speed()),
};
for (const [id, act] of Object.entries(PRESSED)) press(id, (event) => now.state && act(event));
listen("plan", (plan) => {
  refresh();
  if (!plan.fault) say(describePlan());
});
listen("aimed", refresh);
