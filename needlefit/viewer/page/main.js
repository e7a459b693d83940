/** The page: its needles are those of the file, one is shown, and steered by who reads it. */

import { SAME } from "./address.js";
import { computeBands } from "./bands.js";
import { element, part, write } from "./dom.js";
import "./figure.js";
import { buildFields } from "./inputs.js";
import "./keyboard.js";
import { followAddress, nameOf } from "./link.js";
import { SteeredNeedle } from "./model/steered.js";
import { counted } from "./quantities.js";
import { goBack, openDropped, openRecording, restore } from "./recording.js";
import { now, take } from "./store.js";
import { load, prove } from "./stored.js";

/** Show a needle as the file has it: of a recording its end, else the fit at the depth of the measured needle. */
async function choose(/** @type {number} */ number) {
  const { data } = now;
  part("needle-choice").value = number;
  const steered = await SteeredNeedle.begin(data.kernel, data.needles[number].scene);
  if (Number(part("needle-choice").value) !== number) return; // another one has been chosen meanwhile
  const needle = data.needles[number];
  Object.assign(now, { needle, steered, band: null });
  const { scene } = needle;
  openRecording(needle.recording, Boolean(needle.scene.plan));
  take("scene", scene);
  buildFields(needle);
  const specimen = needle.new_specimen ? " (of a specimen that was not fitted)" : "";
  const draws = counted(scene.draws?.sets ?? 0, "posterior draw");
  write("band-note", scene.draws ? `Band: 95 % of the needles of ${draws}${specimen} lie wholly in it. Noise and model error are not included.` : "");
  if (part("origin-mark")) write("origin-mark", scene.origin_mark);
  goBack();
}

/** State how what the file holds agrees with what this browser computes. */
async function stateAgreement() {
  const { data } = now;
  const { count, largest } = await prove(data, SAME);
  const [what, of] = data.needles[0].recording ? ["recorded state", "recording"] : ["needle", data.title ? "report" : "program"];
  const [agrees, place] = [largest < SAME, part("proof")];
  const found = largest === 0 ? `the same bytes as in the ${of}` : `up to ${largest.toExponential(1)} mm from the ${of}`;
  place.className = `quiet ${agrees ? "good" : "bad"}`;
  place.dataset.count = count;
  place.dataset.largest = largest;
  const checked = `Self-check ${agrees ? "passed" : "failed"}: ${counted(count, what)} computed here`;
  write("proof", `${checked}, ${Number.isNaN(largest) ? "one without a result" : found} (needlefit ${data.needlefit}).`);
}

async function start() {
  const data = (now.data = await load());
  const script = new Blob([part("program").textContent], { type: "text/javascript" });
  computeBands(new Worker(URL.createObjectURL(script)));
  const choice = part("needle-choice");
  choice.append(...data.needles.map((one, i) =>
    element("option", { value: String(i) }, [nameOf(one), one.group].filter(Boolean).join(", "))));
  part("choosing").hidden = data.needles.length < 2;
  choice.addEventListener("change", () => choose(Number(choice.value)));
  addEventListener("hashchange", () => followAddress(choose));
  openDropped(choose);
  await choose(0);
  if (!(await followAddress(choose))) restore();
  await stateAgreement();
}

start().catch((error) => {
  write("proof", `The needle was not computed: ${error.message}`);
  part("proof").classList.add("bad");
  throw error;
});
