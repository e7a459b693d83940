/** Target and obstacles: what they are, how they are put and moved, and the plan to reach the target. */

import { command } from "./steering.js";
import { listen, now, publish } from "./store.js";

const SMALLEST = 0.05; // mm, of a radius
const PAUSE = 80; // ms between two goals while one is dragged
let timer = 0;

/** What is aimed at, the reachable region and the plan, as the server sent them last. */
export const aim = { target: null, radius: 2, obstacles: [], reach: null, plan: null, placing: null, challenge: null };

/** Send a goal; what is not given stays. A goal changed by hand ends the game. */
export function setAim(changes) {
  Object.assign(aim, changes);
  aim.plan = aim.challenge = null;
  timer ||= setTimeout(send, PAUSE);
  publish("aimed");
}

function send() {
  timer = 0;
  command({ do: "aim", target: aim.target, radius: aim.radius, obstacles: aim.obstacles });
}

/** Send a goal that still waits, then a message about it. */
export function sendAfterGoal(message) {
  if (timer) {
    clearTimeout(timer);
    send();
  }
  command(message);
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
  else setAim({ obstacles: [...aim.obstacles, [x, y, Math.max(aim.radius, SMALLEST)]] });
  return true;
}

/** Move the target (null) or an obstacle by its number. */
export function moveTo(number, x, y) {
  if (number === null) return setAim({ target: [x, y] });
  setAim({ obstacles: aim.obstacles.map((one, i) => (i === number ? [x, y, one[2]] : one)) });
}

/** Whether the needle touches an obstacle. */
export const touches = ({ x, y }) => aim.obstacles.some(([cx, cy, radius]) => x.some((_, i) => i && distance(cx, cy, x, y, i) < radius));

/** Distance of a point from the piece of a line that ends at its point i. */
function distance(px, py, x, y, i) {
  const [dx, dy] = [x[i] - x[i - 1], y[i] - y[i - 1]];
  const share = ((px - x[i - 1]) * dx + (py - y[i - 1]) * dy) / (dx * dx + dy * dy || 1);
  const at = Math.min(Math.max(share, 0), 1);
  return Math.hypot(px - x[i - 1] - at * dx, py - y[i - 1] - at * dy);
}

/** Distance of the tip from the target, mm; null without one. */
export function tipError({ tip }) {
  return aim.target && Math.hypot(tip.x - aim.target[0], tip.y - aim.target[1]);
}

listen("scene", () => {
  Object.assign(aim, { target: null, obstacles: [], reach: null, plan: null, placing: null, challenge: null });
  publish("aimed");
});
listen("aim", ({ target, radius, obstacles, roll_deg: roll }) => {
  if (timer) return; // it is older than what waits to be sent
  publish("accepted");
  Object.assign(aim, { target, radius, obstacles });
  if (!target) aim.reach = null;
  if (roll) publish("notice", { what: `The needle is rolled by ${roll.toFixed(1)}° about x: its plane holds the target.` });
  publish("aimed");
});
listen("reach", (region) => {
  aim.reach = aim.target && region.x.length ? region : null;
  publish("aimed");
});
listen("plan", (plan) => {
  if (plan.fault) publish("notice", plan.fault);
  aim.plan = plan.fault ? null : plan;
  if (aim.challenge) {
    const touched = Object.values(aim.plan?.touched ?? {}).some((share) => share >= 0.5);
    aim.challenge.planner = touched ? null : (aim.plan?.nominal_miss_mm ?? null);
  }
  publish("aimed");
});
window.needlefit.aim = aim;
