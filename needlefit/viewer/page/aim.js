/** Target and obstacles: what they are, how they are put and moved, and the plan to reach the target. */

import { command } from "./steering.js";
import { listen, now, publish } from "./store.js";

export const SMALLEST = 0.05; // mm, of a radius
const PAUSE = 80; // ms between two goals while one is dragged
const REST = 200; // ms after the last change of needle or goal, when the region that the tip can reach is asked for
const MAX_OBSTACLES = 16; // the server takes no more
const EMPTY = { target: null, radius: 2, obstacles: [] };
const NOTHING = { reach: null, plan: null, planning: false, placing: null };
let [timer, resting] = [0, 0];
let sent = null; // id of the goal that was sent last
let known = EMPTY; // the goal that the server took last
let at = null; // step of the needle

/** What is aimed at (an obstacle: x, y, radius, name), the reachable region and the plan, as the server sent them last. */
export const aim = { ...EMPTY, ...NOTHING };

const goal = () => ({ target: aim.target, radius: aim.radius, obstacles: aim.obstacles });

/** What an obstacle is called. */
export const nameOf = (number) => aim.obstacles[number][3] ?? `obstacle ${number + 1}`;

/** Send a goal; what is not given stays. */
export function setAim(changes) {
  Object.assign(aim, changes, { plan: null, planning: false });
  if (!aim.target) aim.reach = null;
  timer ||= setTimeout(send, PAUSE);
  publish("aimed");
}

function send() {
  timer = 0;
  sent = command({ do: "aim", ...goal() });
}

/** Ask for the region that the tip can reach, once needle and goal rest. */
function askReach() {
  clearTimeout(resting);
  resting = setTimeout(() => aim.target && now.connected && command({ do: "reach" }), REST);
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
  known = EMPTY;
  Object.assign(aim, { target: null, obstacles: [], ...NOTHING });
  publish("aimed");
});
listen("refused", ({ answers }) => { // what was refused is taken back
  aim.planning = false;
  if (answers !== null && answers === sent && !timer) Object.assign(aim, known);
  publish("aimed");
});
listen("aim", ({ target, radius, obstacles, roll_deg: roll }) => {
  known = { target, radius, obstacles };
  if (timer) return; // it is older than what waits to be sent
  publish("accepted");
  Object.assign(aim, known);
  if (!target) aim.reach = null;
  askReach();
  if (roll) publish("notice", { what: `The needle is rolled by ${roll.toFixed(1)}° about x: its plane holds the target.` });
  publish("aimed");
});
listen("reach", (region) => {
  aim.reach = aim.target && region.x.length ? region : null;
  publish("aimed");
});

/** A needle that is moved by hand leaves its plan, whose outcome is then no longer its own. */
listen("state", ({ step, planned }) => {
  if (aim.plan && step !== at && !planned) aim.plan.left = true;
  if (step !== at) askReach();
  at = step;
});
listen("plan", (plan) => {
  if (plan.fault) publish("notice", plan.fault);
  aim.planning = false;
  aim.plan = plan.fault ? null : { ...plan, left: plan.step !== now.state.step && !now.state.planned };
  publish("aimed");
});
window.needlefit.aim = aim;
