/** The plane of b and one modulus with the draws of the posterior: a point that is dragged sets both. */

import { element, onScheme, write } from "./dom.js";
import { listSteps } from "./model/inputs.js";
import { SteeredNeedle } from "./model/steered.js";
import { cross, faintly, palette, ring, segments, setFont, stroke, trace } from "./painters/strokes.js";
import { brief, listErrors, modulusLike, strengthOf, toDegrees } from "./quantities.js";
import { listen, now } from "./store.js";

const PAD = { left: 48, right: 8, top: 22, bottom: 22 }; // px
const MARGIN = 0.12; // of the range of the draws
const SAME = 1e-9; // variance of a logarithm; less is a parameter that is fixed
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
const PART = 0.02; // of the range, a key
const LINE = { step: 0.04, trial: 0.02, secants: 3, miss_mm: 0.005 }; // step and trial: parts of the plane
const TIED = 0.9999; // correlation of moduli that are one parameter
const TICKS = [1, 2, 5].flatMap((one) => Array.from({ length: 14 }, (_, n) => one * 10 ** (n - 4)));

const mean = (values) => values.reduce((sum, one) => sum + one, 0) / values.length;
function covary(one, other) {
  const [middle, centre] = [mean(one), mean(other)];
  return mean(one.map((value, i) => (value - middle) * (other[i] - centre)));
}

const correlate = (one, other) => covary(one, other) / Math.sqrt(covary(one, one) * covary(other, other)) || 0;

/** The draws of a scene as logarithms: of b, or the angle of the cut, and of each modulus, Pa; which modulus is the most correlated with b. */
function readDraws({ draws, fitted: { layers }, simulation: { model } }) {
  const b = Array.from(draws.strength, (one) => Math.log(model.pathAngle ? toDegrees(one) : one));
  const mu = layers.map((_, layer) => b.map((_, draw) => Math.log(draws.mu[draw * layers.length + layer] * 1e6)));
  const related = mu.map((one) => Math.abs(correlate(b, one)));
  return { b, mu, layer: related.indexOf(Math.max(...related)) };
}

/** Whether a scene has draws in which b and a modulus vary. */
export function isDrawnPlane(scene) {
  if (!scene.draws) return false;
  const { b, mu, layer } = readDraws(scene);
  return covary(b, b) > SAME && covary(mu[layer], mu[layer]) > SAME;
}

const toUnit = (vector) => vector.map((one) => one / Math.hypot(...vector));

/** The next place of the line: a step along, then secants across; null where there is none. */
function findNext(from, along, miss) {
  const place = (across) => from.map((part, i) => part + LINE.step * along[i] + across * [-along[1], along[0]][i]);
  let [one, other] = [0, LINE.trial];
  try {
    let [before, missed] = [miss(place(one)), miss(place(other))];
    for (let n = 0; n < LINE.secants; n += 1) {
      [one, other] = [other, other - (missed * (other - one)) / (missed - before)];
      [before, missed] = [missed, miss(place(other))];
    }
    return Math.abs(missed) < LINE.miss_mm && Math.abs(other) < LINE.step ? place(other) : null;
  } catch (error) {
    if (!error.expected) throw error; // else there is no needle
    return null;
  }
}

/** Make the plane of the scene that is shown. `steer` is given the changes of a moved point: other parameters stay. */
export function makeRidge(into, steer, kernel) {
  const { scene } = now;
  const { fitted, layer_names: names } = scene;
  const { key, symbol, unit, digits, throughout, value } = strengthOf(fitted);
  const { b, mu, layer } = readDraws(scene);
  const origin = [value, fitted.layers[layer].mu_pa].map(Math.log);
  const tied = fitted.layers.map((_, i) => i).filter((i) => correlate(mu[i], mu[layer]) > TIED); // layers of one parameter
  const modulus = modulusLike(fitted.layers[layer].mu_pa);
  const called = `μ ${names[layer] || `layer ${layer + 1}`}`;
  const ranges = [b, mu[layer]].map((values, i) => {
    const [low, high] = [Math.min(...values, origin[i]), Math.max(...values, origin[i])];
    return [low - MARGIN * (high - low), high + MARGIN * (high - low)];
  });
  const canvas = element("canvas", { className: "ridge", tabIndex: 0, ariaLabel: `${symbol} and ${called}: arrow keys move the point` });
  canvas.setAttribute("role", "application");
  const note = element("p", { className: "quiet" });
  into.replaceChildren(canvas, note);
  const context = canvas.getContext("2d");
  const current = () => [now.state.bevel[key], now.state.layers[layer].mu_pa].map(Math.log);
  const box = () => [[PAD.left, canvas.clientWidth - PAD.right], [canvas.clientHeight - PAD.bottom, PAD.top]];
  const toPx = (place) => box().map(([from, to], i) => from + ((place[i] - ranges[i][0]) / (ranges[i][1] - ranges[i][0])) * (to - from));
  const line = []; // pairs with which the tip ends where that of the fit does
  let [wanted, frame, held] = [null, 0, false];

  /** The changes that bring b and the modulus to a place. */
  const listChanges = (place) => {
    const moved = place[1] - origin[1];
    return [[throughout, null, Math.exp(place[0])], ...tied.map((i) => ["mu_pa", i + 1, fitted.layers[i].mu_pa * Math.exp(moved)])];
  };

  /** Find the line from the fit on, to both sides; places are parts of the plane, from the fit. */
  async function findLine() {
    const always = { validOnly: false };
    const needle = await SteeredNeedle.begin(await kernel, scene);
    for (const changes of listSteps(scene)) needle.apply(changes, always);
    const goal = needle.tipLateral;
    const toPlane = (place) => place.map((part, i) => origin[i] + part * (ranges[i][1] - ranges[i][0]));
    const miss = (place) => {
      needle.apply(listChanges(toPlane(place)), always);
      return needle.tipLateral - goal;
    };
    const steepest = [[LINE.trial, 0], [0, LINE.trial]].map(miss);
    for (const way of [-1, 1]) {
      let [from, along] = [[0, 0], toUnit([-way * steepest[1], way * steepest[0]])];
      while (from && canvas.isConnected) {
        way < 0 ? line.unshift(toPlane(from)) : line.push(toPlane(from));
        const to = findNext(from, along, miss);
        const within = to && toPlane(to).every((value, i) => value >= ranges[i][0] && value <= ranges[i][1]);
        if (within) along = toUnit(to.map((part, i) => part - from[i]));
        from = within ? to : null;
        draw();
        await new Promise((done) => setTimeout(done));
      }
    }
  }

  /** Move the point once in a frame, within the plane. */
  function ask(place) {
    wanted = place.map((one, i) => Math.min(Math.max(one, ranges[i][0]), ranges[i][1]));
    frame ||= requestAnimationFrame(() => {
      frame = 0;
      steer([listChanges(wanted)]);
    });
  }

  function drag({ clientX, clientY }) {
    const { left, top } = canvas.getBoundingClientRect();
    ask([clientX - left, clientY - top].map((px, i) => {
      const [from, to] = box()[i];
      return ranges[i][0] + ((px - from) / (to - from)) * (ranges[i][1] - ranges[i][0]);
    }));
  }

  function draw() {
    if (!canvas.isConnected) return;
    const { clientWidth: width, clientHeight: height } = canvas;
    Object.assign(canvas, { width: width * devicePixelRatio, height: height * devicePixelRatio });
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    const [[left, right], [bottom, top]] = box();
    context.strokeStyle = palette.quiet;
    context.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
    context.fillStyle = palette.label;
    setFont(context, "small", "left");
    context.fillText(`${called}, ${modulus.unit}`, 2, 9);
    setFont(context, "small", "right");
    context.fillText(`${symbol}, ${unit}`, right, bottom + 13);
    paintTicks(0, (one) => one, right - 40);
    paintTicks(1, (one) => modulus.read(one), Infinity);
    faintly(context, 0.55, () => b.forEach((one, i) => {
      const [px, py] = toPx([one, mu[layer][i]]);
      context.fillStyle = palette.band;
      context.fillRect(px - 1.5, py - 1.5, 3, 3);
    }));
    trace(context, line.map(toPx));
    stroke(context, palette.accent, 2);
    segments(context, cross(...toPx(origin), 5), palette.needle, 2);
    ring(context, ...toPx(current()), 7, palette.tip, palette.air);
  }

  /** Numbers along one axis, apart by 30 px at least. */
  function paintTicks(axis, read, end) {
    let last = -Infinity;
    for (const one of TICKS.toSorted((a, z) => a - z)) {
      const at = Math.log(read(one));
      if (at < ranges[axis][0] || at > ranges[axis][1]) continue;
      const px = toPx(axis ? [ranges[0][0], at] : [at, ranges[1][0]]);
      if (Math.abs(px[axis] - last) < 30 || px[0] > end) continue;
      last = px[axis];
      setFont(context, "small", axis ? "right" : "center");
      context.fillText(brief(one), px[0] - (axis ? 4 : 0), px[1] + (axis ? 0 : 13));
    }
  }

  function refresh() {
    if (!canvas.isConnected) return;
    const { bevel, layers, errors, tip } = now.state;
    const found = errors ? listErrors(errors, now.scene.measured).slice(0, 2).join(", ")
      : now.pinned ? `the tip is ${Math.hypot(tip.x - now.pinned.x.at(-1), tip.y - now.pinned.y.at(-1)).toFixed(3)} mm from the pinned one` : "";
    write(note, `${symbol} ${bevel[key].toFixed(digits)} ${unit}, ${called} ${modulus.write(layers[layer].mu_pa, 3)} ${modulus.unit}: ${found}. Other parameters stay as fitted.`);
    draw();
  }

  const heard = {
    pointerdown: (event) => {
      canvas.setPointerCapture(event.pointerId);
      held = true;
      drag(event);
    },
    pointermove: (event) => held && drag(event),
    pointerup: () => (held = false),
    pointercancel: () => (held = false),
    keydown: (event) => {
      if (!(event.key in KEYS)) return;
      event.preventDefault();
      event.stopPropagation(); // here they do not move the needle
      const from = frame ? wanted : current();
      ask(from.map((one, i) => one + KEYS[event.key][i] * PART * (ranges[i][1] - ranges[i][0])));
    },
  };
  for (const [kind, hear] of Object.entries(heard)) canvas.addEventListener(kind, hear);
  [refreshShown, drawShown] = [refresh, draw];
  refresh();
  findLine();
}

let [refreshShown, drawShown] = [() => {}, () => {}]; // of the plane that is shown
listen("state", () => refreshShown());
onScheme(() => requestAnimationFrame(drawShown));
