/** Target and obstacles: what they are, how they are put and moved, and the plan to reach the target. */

import { command } from "./steering.js";
import { listen, now, publish } from "./store.js";

export const SMALLEST = 0.05; // mm, of a radius
const MOST = 1000; // mm, of a coordinate and a radius
const MAX_OBSTACLES = 16; // the server takes no more
const NOTHING = { target: null, obstacles: [], plan: null, planning: false, placing: null };
let asked = null; // id of the newest message
let at = null; // step of the needle

/** What is aimed at (an obstacle: x, y, radius), and the plan, as the server sent it last. */
export const aim = { radius: 2, ...NOTHING };

/** What an obstacle is called. */
export const nameOf = (number) => `obstacle ${number + 1}`;

/** Aim at something else; what is not given stays. */
export function setAim(changes) {
  const { target, radius, obstacles } = { ...aim, ...changes };
  if ([target ?? [], radius, obstacles].flat(2).every((one) => Math.abs(one) <= MOST)) {
    Object.assign(aim, changes, { plan: null, planning: false });
    asked = null;
    publish("goal");
  } else publish("refused", { what: "the target or an obstacle is out of range", expected: `numbers of at most ${MOST} mm` });
  publish("aimed");
}

export function askPlan() {
  asked = command({ do: "plan", target: aim.target, radius: aim.radius, obstacles: aim.obstacles });
  aim.planning = true;
}

/** Wait for a place on the picture: of the "target" or an "obstacle"; null: no more. */
export function place(what) {
  aim.placing = aim.placing === what ? null : what;
  publish("aimed");
}

/** Put what waits for a place at (x, y), mm; returns whether something did. */
export function put(x, y) {
  const what = aim.placing;
  if (!what) return false;
  aim.placing = null;
  if (what === "target") setAim({ target: [x, y] });
  else if (aim.obstacles.length < MAX_OBSTACLES) setAim({ obstacles: [...aim.obstacles, [x, y, Math.max(aim.radius, SMALLEST)]] });
  else {
    publish("notice", { what: `There are ${MAX_OBSTACLES} obstacles.`, expected: `at most ${MAX_OBSTACLES}`, fix: "remove one" });
    publish("aimed");
  }
  return true;
}

/** Move the target (null) or an obstacle by its number. */
export function moveTo(number, x, y) {
  if (number === null) return setAim({ target: [x, y] });
  setAim({ obstacles: aim.obstacles.map((one, i) => (i === number ? [x, y, ...one.slice(2)] : one)) });
}

/** Distance of the tip from the target, mm; null without one. */
export const tipError = ({ tip }) => aim.target && Math.hypot(tip.x - aim.target[0], tip.y - aim.target[1]);

listen("scene", () => {
  Object.assign(aim, NOTHING);
  publish("aimed");
});
listen("refused", () => {
  aim.planning = false;
  publish("aimed");
});

/** A needle that is moved by hand leaves its plan, whose outcome is then no longer its own. */
listen("state", ({ step, planned }) => {
  if (aim.plan && step !== at && !planned) aim.plan.left = true;
  at = step;
});
listen("plan", (plan) => {
  if (plan.answers !== asked) return;
  if (plan.fault) publish("notice", plan.fault);
  aim.planning = false;
  aim.plan = plan.fault ? null : { ...plan, left: plan.step !== now.state.step && !now.state.planned };
  publish("aimed");
});
Object.assign(now, { aim });
