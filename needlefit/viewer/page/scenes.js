/** Three scenes of one sentence: each sets the needle, pins it, and gives one control and one line of what to see. */

import { button, element, part, write } from "./dom.js";
import { makeField, show } from "./fields.js";
import { listSteps, rollOf, turnOver } from "./model/inputs.js";
import { modulusLike } from "./quantities.js";
import { isDrawnPlane, makeRidge } from "./ridge.js";
import { listen, now } from "./store.js";
import { pin } from "./strip.js";
import { toggle } from "./toolbar.js";

const ANEW = [["return_to", null, 0]];
const TURNS = [0.2, 0.8]; // of the depth, between which the turn is moved
const STIFFER = 10; // times the modulus of the softest layer

/** Changes from first contact on: the bevel turns over once, at a depth in mm. */
function listTurned(depth, { simulation: { steps: [first] }, depth_mm: deepest }) {
  return [ANEW, [["depth_mm", null, depth]], [turnOver(rollOf(first.bevel))], [["depth_mm", null, deepest]]];
}

/** The number, from 1, of the softest layer that the needle enters. */
function findSoftest({ fitted: { layers }, boundaries_mm: tops, depth_mm: deepest }) {
  const moduli = layers.slice(0, 1 + tops.filter((top) => top < deepest).length).map(({ mu_pa: mu }) => mu);
  return 1 + moduli.indexOf(Math.min(...moduli));
}

const SCENES = [
  {
    sentence: "Turn the bevel half way: the needle makes an S.",
    see: "Behind the turn the needle bends to the other side. Dotted: the needle of the scene. Move the turn.",
    begin(into, steer) {
      const { scene } = now;
      const turn = (depth) => {
        steer(listTurned(depth, scene));
        show(field, depth);
      };
      const limits = TURNS.map((share) => share * scene.depth_mm);
      const field = makeField(into, { name: "turn at depth", unit: "mm", write: (value) => value.toFixed(1), limits, ask: turn });
      turn(scene.depth_mm / 2);
    },
  },
  {
    sentence: "Stiffen one layer: where does the force go?",
    see: "Purple areas are the load across the needle: it grows in the stiff layer and at its edges. Dotted: the needle before.",
    begin(into, steer) {
      toggle("load", true);
      const { fitted: { layers }, limits: { mu_pa: limits }, layer_names: names } = now.scene;
      const layer = findSoftest(now.scene);
      const { mu_pa: from } = layers[layer - 1];
      const stiffen = (value) => {
        steer([[["mu_pa", layer, value]]]);
        show(field, value);
      };
      const about = { ...modulusLike(from * STIFFER), name: `μ ${names[layer - 1] || `layer ${layer}`}`, symbol: "μ", logarithmic: true, step: 1.05 };
      const field = makeField(into, { ...about, limits, ask: stiffen });
      stiffen(Math.min(from * STIFFER, limits[1]));
    },
  },
  {
    sentence: "Which b and μ fit equally well? Drag along the ridge.",
    see: "Line: pairs with which the tip ends where that of the fit does. Along it the needle hardly moves; across it, it does. Dots: draws of the posterior, whose other parameters differ too.",
    fits: isDrawnPlane,
    begin: makeRidge,
  },
];

/** Offer the scenes that the needle allows. `steer(lists)` carries out lists of changes, one after the other; `kernel` is or resolves to the compiled one. */
export function offerScenes(steer, kernel) {
  let begin = null; // of a scene, once the needle to compare with has come to rest
  const list = part("scene-list");
  const choose = (scene, pressed) => {
    for (const one of list.querySelectorAll("button")) one.ariaPressed = String(one === pressed);
    part("scene-control").replaceChildren();
    write("see", scene.see);
    begin = () => {
      if (now.pinned) pin();
      pin();
      scene.begin(part("scene-control"), steer, kernel);
    };
    steer([ANEW, ...listSteps(now.scene)]);
  };
  listen("scene", (shown) => {
    begin = null;
    part("scene-control").replaceChildren();
    write("see", "");
    list.replaceChildren(...SCENES.filter(({ fits }) => !fits || fits(shown)).map((scene) => {
      const pressed = button(scene.sentence, () => now.state && choose(scene, pressed), { ariaPressed: "false" });
      return element("li", {}, pressed);
    }));
  });
  listen("forces", ({ step }) => {
    if (step !== now.state.step || !begin) return;
    const then = begin;
    begin = null;
    then();
  });
}
