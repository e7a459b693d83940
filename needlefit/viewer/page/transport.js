/** What inserts the needle: buttons that are held or pressed, a depth, the wheel; a new needle is inserted by itself. */

import { part, press, write } from "./dom.js";
import * as act from "./actions.js";
import { listSteps } from "./model/inputs.js";
import { notches } from "./pointers.js";
import { brief, describeRoll } from "./quantities.js";
import { command, halt, letGo, rebuild } from "./steering.js";
import { listen, now } from "./store.js";

const STEP = 1; // mm; what a mere click does, as assistive technology gives it, and a notch of the wheel

/** A button that moves the needle as long as it is held, by pointer, space or enter. */
function holdButton(button, direction) {
  let held = false;
  const begin = () => {
    if (held || !now.state) return;
    held = true;
    act.hold(direction);
  };
  const end = () => {
    if (held) letGo();
    held = false;
  };
  button.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    button.setPointerCapture(event.pointerId);
    begin();
  });
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    begin();
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "keyup", "blur"]) button.addEventListener(kind, end);
  button.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch is a hold
  press(button, ({ detail, timeStamp }) => detail === 0 && now.state && act.insert(STEP * direction, timeStamp));
}

/** Let the buttons say what can be done, and the bevel's which side it turns to. */
export function refresh() {
  const { undo, redo, moving, playing, bevel } = now.state;
  part("undo").disabled = !undo;
  part("redo").disabled = !redo;
  part("halt").disabled = !moving && !playing;
  part("insert").classList.toggle("on", moving > 0);
  part("retract").classList.toggle("on", moving < 0);
  write("side", `(now ${describeRoll(bevel)})`);
}

const PRESSED = {
  undo: act.undo, redo: act.redo, reset: act.reset, play: act.play, halt,
  flip: (event) => act.flip(event.timeStamp),
};
for (const [id, act] of Object.entries(PRESSED)) press(id, (event) => now.state && act(event));
holdButton(part("insert"), 1);
holdButton(part("retract"), -1);
part("goto").addEventListener("submit", (event) => {
  event.preventDefault();
  if (now.state) act.goTo(Number(part("goto-depth").value));
});

part("canvas").addEventListener("wheel", (event) => {
  if (event.ctrlKey || event.metaKey) return; // it zooms
  event.preventDefault();
  if (now.state) act.insert(-STEP * notches(event), event.timeStamp);
}, { passive: false });

let begun = false;

part("choices").addEventListener("change", () => command({ do: "show", insertion: part("choices").value }));

/** The first needle carries out the steps of its scene, all at once where the user wants less motion. */
listen("state", ({ depth_mm: depth, undo }) => {
  if (begun) return;
  begun = true;
  if (depth > 0 || undo) return;
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) rebuild(listSteps(now.scene));
  else act.play();
});
listen("go to", act.goTo);
listen("scene", (scene) => {
  part("note").textContent = scene.note;
  document.title = `${scene.title} · needlefit view`;
  write("origin-mark", scene.origin_mark);
  part("choice").hidden = scene.choices.length < 2;
  part("choices").replaceChildren(...scene.choices.map(([name, title]) => new Option(title, name)));
  if (!scene.measured) part("choices").prepend(new Option("none", ""));
  part("choices").value = scene.measured?.id ?? "";
  part("goto-depth").value = brief(scene.depth_mm);
  part("goto-depth").max = scene.limits.depth_mm;
});
