/** The live fit: to the measured needle, whose points can be dragged, or to more of them; and its ridge. */

import { onScheme, part, press, say } from "./dom.js";
import { invalidate } from "./drawing.js";
import { points } from "./handles.js";
import { palette, setFont } from "./painters/strokes.js";
import { layerInputs } from "./panel.js";
import { brief, counted, modulus, strengthOf } from "./quantities.js";
import { change, command } from "./steering.js";
import { listen, now, publish } from "./store.js";

const SCOPES = { insertion: "this needle", specimen: "its specimen", dataset: "all of its medium" };
const PAD = 34; // px of the ridge's axes
const MISFIT = 2; // rms residual, in stated errors, above which a fit is doubted
let ridge = null;
let mode = null;
let asked = null; // id of the fit asked for last

const ask = () => begin({ do: "fit" });

/** Send where the points are now; the server fits to them. */
points.send = () => begin({ do: "points", offsets: points.offsets });

/** Ask for a fit; what was found before is not the answer any more. */
function begin(message) {
  asked = command({ ...message, scope: part("fit-scope").value });
  if (asked === null) return;
  part("fit").ariaBusy = "true";
  part("fit-note").textContent = "Fitting …";
  forgetRidge();
}

function forgetRidge() {
  ridge = null;
  part("ridge").hidden = true;
  part("ridge-note").textContent = "";
}

/** A fit that failed, or was refused, leaves no result. */
function end(words = "") {
  part("fit").ariaBusy = null;
  part("fit-note").textContent = words;
}

/** The parameters of the fit become inputs like those of a hand, so that a recording holds them. */
function takeMode(message) {
  if (message.fault) {
    end("The fit failed.");
    return publish("notice", message.fault);
  }
  mode = message;
  const { throughout } = strengthOf(now.state.bevel);
  const names = layerInputs();
  const layers = message.layers.flatMap((values, i) => values.map((value, j) => [names[j], i + 1, value]));
  change([...layers, [throughout, null, message.offset_mm]]);
  const { insertions, seconds, misfit, at_bounds: bounds } = message;
  // what a reader must know before these values are used
  const far = misfit > MISFIT ? ` The residuals are ${misfit.toFixed(1)} times the stated errors: the model does not describe these points.` : "";
  const bound = bounds.length ? ` At its bound: ${bounds.join(", ")}.` : "";
  part("fit-note").textContent = `Fitted to ${counted(insertions, "needle")} in ${seconds.toFixed(2)} s: b ${message.offset_mm.toFixed(3)} mm, `
    + `first layer μ ${modulus(message.layers[0][0])}.${far}${bound} Drawing …`;
}

function takeRidge(message) {
  ridge = message;
  const [low, high] = limits(message.mu_pa).map(modulus);
  const [less, more] = limits(message.offset_mm).map((one) => brief(one, 3));
  const sure = message.certified ? "" : " The weights of these draws cannot be relied on.";
  const words = `95 % of draws: first layer μ ${low} to ${high}, b ${less} to ${more} mm; `
    + `correlation of their logarithms ${message.correlation.toFixed(2)}.${sure}`;
  end(part("fit-note").textContent.replace(" Drawing …", ""));
  part("ridge-note").textContent = words;
  part("ridge").hidden = false;
  drawRidge();
  say(words);
}

function limits(values) {
  const sorted = values.toSorted((one, other) => one - other);
  return [0.025, 0.975].map((share) => sorted[Math.round(share * (sorted.length - 1))]);
}

/** Draws of mu (up, logarithmic) against b: where they lie along a line, the data leave their ratio open. */
function drawRidge() {
  const canvas = part("ridge");
  if (!ridge) return;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * devicePixelRatio;
  canvas.height = height * devicePixelRatio;
  const context = canvas.getContext("2d");
  context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  const logs = [ridge.offset_mm, ridge.mu_pa].map((values) => values.map(Math.log));
  const spans = logs.map((values) => [Math.min(...values), Math.max(...values) + 1e-9]);
  const at = (values, axis, length) => values.map((one) => ((one - spans[axis][0]) / (spans[axis][1] - spans[axis][0])) * length);
  const px = at(logs[0], 0, width - 2 * PAD).map((one) => PAD + one);
  const py = at(logs[1], 1, height - 2 * PAD).map((one) => height - PAD - one);
  context.strokeStyle = palette.quiet;
  context.strokeRect(PAD - 6.5, PAD - 6.5, width - 2 * PAD + 13, height - 2 * PAD + 13);
  context.fillStyle = palette.band;
  px.forEach((one, i) => context.fillRect(one - 1.5, py[i] - 1.5, 3, 3));
  context.fillStyle = palette.label;
  const [[less, more], [low, high]] = spans.map((span) => span.map(Math.exp));
  setFont(context, "small", "left", "alphabetic");
  context.fillText(`μ ${modulus(high)}`, 2, 14);
  context.fillText(`μ ${modulus(low)}`, 2, height - PAD + 18);
  context.fillText(`b ${brief(less, 3)}`, PAD - 4, height - 6);
  context.textAlign = "right";
  context.fillText(`b ${brief(more, 3)} mm`, width - 4, height - 6);
}

press("fit-now", () => now.state && ask());
press("fit-drag", ({ currentTarget }) => {
  points.shown = !points.shown;
  currentTarget.ariaPressed = String(points.shown);
  invalidate();
});
press("fit-back", () => points.reset());
part("fit-scope").addEventListener("change", () => mode && ask());
listen("fit", takeMode);
listen("refused", ({ answers }) => answers !== null && answers === asked && end());
listen("ridge", takeRidge);
listen("scene", ({ fit }) => {
  part("fit").hidden = !fit;
  mode = null;
  points.begin();
  forgetRidge();
  end();
  part("fit-drag").ariaPressed = "false";
  if (!fit) return;
  const scopes = Object.keys(SCOPES).filter((one) => one === "insertion" || fit[one] > 1);
  part("fit-scope").replaceChildren(...scopes.map((one) => new Option(fit[one] > 1 ? `${SCOPES[one]} (${fit[one]})` : SCOPES[one], one)));
});
listen("measured", ({ x, y, s, target }) => {
  if (now.scene.measured) Object.assign(now.scene.measured, { x, y, s, target });
  invalidate();
});
onScheme(() => requestAnimationFrame(drawRidge));
