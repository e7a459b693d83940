/** What a needle at the end of its scene shows: where a turn makes an S, and which layer, once stiffer, moves force. */

import { smooth } from "../quantities.js";
import { rollOf, turnOver } from "./inputs.js";

export const ANEW = [["return_to", null, 0]];
const TURNS = [0.5, 0.6, 0.4, 0.7, 0.3, 0.2]; // of the depth: where the turn is tried
const NOISE = 0.1; // mm, where no noise is stated: an S bends by more
const STIFFER = 10; // times the modulus of a layer
const MOVED = 0.05; // of all force: less is not seen to move
const always = { validOnly: false };

/** Changes from first contact on: the bevel turns over once, at a depth in mm. */
export function listTurned(depth, { simulation: { steps: [first] }, depth_mm: deepest }) {
  return [ANEW, [["depth_mm", null, depth]], [turnOver(rollOf(first.bevel))], [["depth_mm", null, deepest]]];
}

/** How far, mm, the inserted part of a needle lies to either side of the line from its entry to its tip. */
function listAway({ session: { shape: { x, u } } }) {
  const first = x.findIndex((one) => one >= 0);
  const slope = (u[x.length - 1] - u[first]) / (x[x.length - 1] - x[first]);
  return [...x.keys()].slice(first).map((i) => u[i] - u[first] - slope * (x[i] - x[first]));
}

/** The depth, mm, at which a turn makes an S that bends by more than the noise; null where there is none, or other inputs than the bevel's change. */
export function findTurn(needle) {
  const { scene } = needle;
  const { steps: [first, ...rest] } = scene.simulation;
  const inputs = ({ bevel, controls }) => JSON.stringify([bevel, controls]);
  if (rest.some((one) => inputs(one) !== inputs(first))) return null;
  const makesS = (depth) => {
    for (const changes of listTurned(depth, scene)) needle.apply(changes, always);
    const away = listAway(needle);
    return Math.min(Math.max(...away), -Math.min(...away)) > (scene.measured?.floor_mm ?? NOISE);
  };
  return TURNS.map((one) => Math.round(one * scene.depth_mm)).find(makesS) ?? null;
}

/** The lateral force, N, that each layer puts on a needle: the size of the load as it is drawn, added up. */
export function findLayerForces(x, loads, { boundaries_mm: tops, spacing_mm: spacing }) {
  const planes = loads.map((one) => smooth(x, one, spacing));
  const forces = Array.from({ length: tops.length + 1 }, () => 0);
  for (let i = 1; i < x.length; i += 1) {
    const [one, other] = [i - 1, i].map((at) => Math.hypot(...planes.map((plane) => plane[at])));
    const middle = (x[i] + x[i - 1]) / 2;
    forces[tops.filter((top) => top <= middle).length] += ((one + other) / 2) * (x[i] - x[i - 1]);
  }
  return forces;
}

const add = (values) => values.reduce((sum, one) => sum + one, 0);

/**
 * The layer whose stiffening moves the most force: {layer, from, to: Pa, before: N by layer}; null where that is next to none,
 * in a single layer, and where the model is left.
 */
export function findStiffer(needle) {
  const { scene } = needle;
  const { fitted: { layers }, limits: { mu_pa: limits }, boundaries_mm: tops, depth_mm: deepest } = scene;
  const read = () => {
    const { s, loads } = needle.session.forces();
    return findLayerForces([...s], loads.map((one) => [...one]), scene);
  };
  const before = read();
  const entered = 1 + tops.filter((top) => top < deepest).length;
  if (entered < 2 || !needle.valid) return null;
  const found = layers.slice(0, entered).map(({ mu_pa: from }, i) => {
    const to = Math.min(from * STIFFER, limits[1]);
    needle.apply([["mu_pa", i + 1, to]], always);
    const [after, { valid }] = [read(), needle];
    needle.apply([["mu_pa", i + 1, from]], always);
    return { valid, layer: i + 1, from, to, before, moved: Math.abs(after[i] - before[i]), all: add(after) };
  });
  const best = found.filter(({ valid }) => valid).toSorted((one, other) => other.moved - one.moved)[0];
  return best && best.moved >= MOVED * best.all ? best : null;
}
