/** Scenes of one sentence, those that the needle of a scene shows: each sets it, pins it, and gives one control and what to see. */

import { button, element, part, write } from "./dom.js";
import { further } from "./drawing.js";
import { makeField, show } from "./fields.js";
import { listSteps } from "./model/inputs.js";
import { ANEW, findLayerForces, findStiffer, findTurn, listTurned } from "./model/probes.js";
import { SteeredNeedle } from "./model/steered.js";
import { labelFree, palette, ring, segments, setFont } from "./painters/strokes.js";
import { heightAt, modulusLike } from "./quantities.js";
import { steer } from "./steering.js";
import { listen, now } from "./store.js";
import { pin } from "./strip.js";
import { toggle } from "./toolbar.js";
import { toPx, toPy } from "./view.js";

const BETWEEN = [0.1, 0.9]; // of the depth, between which the turn is moved
let marks = []; // of the scene that is shown: {depth, mm, text}, labelled in the picture

/** The scene of a turn; null where the needle makes no S by it alone. */
function prepareTurn(needle) {
  const { scene } = needle;
  const from = findTurn(needle);
  if (from === null) return null;
  return {
    sentence: `Turn the bevel at ${from} mm: the needle makes an S.`,
    see: () => "Behind the turn the needle bends to the other side. Dotted: without the turn. Move it.",
    begin(into) {
      const turn = (depth) => {
        marks = [{ depth, text: "turn" }];
        steer(listTurned(depth, scene));
        show(field, depth);
      };
      const limits = BETWEEN.map((one) => one * scene.depth_mm);
      const field = makeField(into, { name: "turn at depth", unit: "mm", write: (value) => value.toFixed(1), limits, ask: turn });
      turn(from);
    },
  };
}

/** The scene of the layer whose stiffening moves the most force; null where that is next to none. */
function prepareStiffer(needle) {
  const best = findStiffer(needle);
  if (!best) return null;
  const { scene } = needle;
  const { limits: { mu_pa: limits }, layer_names: names, boundaries_mm: tops, depth_mm: deepest } = scene;
  const { layer, from, to, before } = best;
  const called = names[layer - 1] || `layer ${layer}`;
  const ends = [...tops, Infinity];
  const middle = ((layer > 1 ? tops[layer - 2] : 0) + Math.min(ends[layer - 1], deepest)) / 2;
  const readShown = () => findLayerForces(now.state.load.x, now.state.load.n_per_mm, scene);
  return {
    sentence: `Stiffen ${called}: where does the force go?`,
    see: () => {
      if (now.state.faults.length) {
        marks = [];
        return "The needle is outside the limits of the model: its forces are not shown.";
      }
      const after = readShown();
      marks = [{ depth: middle, text: `${after[layer - 1].toFixed(1)} N here` }];
      return `Lateral force of ${called}: ${before[layer - 1].toFixed(1)} to ${after[layer - 1].toFixed(1)} N (100 g weigh 1 N). Purple: the load, where it acts. Dotted: the needle before.`;
    },
    begin(into) {
      toggle("load", true);
      const stiffen = (value) => {
        steer([[["mu_pa", layer, value]]]);
        show(field, value);
      };
      const about = { ...modulusLike(to), name: `μ ${called}`, symbol: "μ", logarithmic: true, step: 1.05 };
      const field = makeField(into, { ...about, limits, ask: stiffen });
      stiffen(to);
    },
  };
}

/** The scenes that the needle of a scene shows, found with a needle of their own. */
async function prepareScenes(kernel, scene) {
  const needle = await SteeredNeedle.begin(kernel, scene);
  const prepare = (one) => {
    try {
      for (const changes of [ANEW, ...listSteps(scene)]) needle.apply(changes, { validOnly: false });
      return one(needle);
    } catch (error) {
      if (!error.expected) throw error;
      return null; // there is no needle
    }
  };
  return [prepareTurn, prepareStiffer].map(prepare).filter((one) => one);
}

/** Offer the scenes that the needle allows. `kernel` is the compiled one. */
export function offerScenes(kernel) {
  let [begin, shown] = [null, null]; // of a scene, once the needle to compare with has come to rest; the scene that is shown
  const list = part("scene-list");
  const leave = () => {
    [begin, shown, marks] = [null, null, []];
    part("scene-control").replaceChildren();
    write("see", "");
  };
  const choose = (scene, pressed) => {
    for (const one of list.querySelectorAll("button")) one.ariaPressed = String(one === pressed);
    leave();
    begin = () => {
      if (now.pinned) pin();
      pin();
      shown = scene;
      scene.begin(part("scene-control"));
    };
    steer([ANEW, ...listSteps(now.scene)]);
  };
  listen("scene", async (given) => {
    leave();
    list.replaceChildren();
    const scenes = await prepareScenes(kernel, given);
    if (now.scene !== given) return; // another one has been opened meanwhile
    list.replaceChildren(...scenes.map((scene) => {
      const pressed = button(scene.sentence, () => now.state && choose(scene, pressed), { ariaPressed: "false" });
      return element("li", {}, pressed);
    }));
  });
  listen("state", () => shown && write("see", shown.see()));
  listen("forces", ({ step }) => {
    if (step !== now.state.step || !begin) return;
    const then = begin;
    begin = null;
    then();
  });
}

/** Label what a scene is about where it acts. */
further.push((context) => {
  for (const { depth, text } of marks) {
    const [px, py] = [toPx(depth), toPy(heightAt(now.state, depth))];
    segments(context, [[[px, py - 12], [px, py + 12]]], palette.accent, 2);
    ring(context, px, py, 4, palette.accent, palette.air);
    setFont(context, "strong");
    labelFree(context, text, [[px, py - 26], [px, py + 26], [px + 40, py - 26], [px - 40, py + 26]], palette.accent);
  }
});
