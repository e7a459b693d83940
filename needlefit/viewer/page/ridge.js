/** The plane of b and one modulus, coloured by the error of the needle: a point that is dragged along its valley sets both. */

import { element, onScheme, write } from "./dom.js";
import { mean, readPoints } from "./model/errors.js";
import { listSteps } from "./model/inputs.js";
import { compareWith, computePlane, equalWithin, findContour, findSlope, findTied, findValley, hasRidge, makeTarget, readDraws } from "./model/plane.js";
import { SteeredNeedle } from "./model/steered.js";
import { between, cross, faintly, palette, ring, segments, setFont, stroke, trace } from "./painters/strokes.js";
import { brief, modulusLike, strengthOf } from "./quantities.js";
import { steer } from "./steering.js";
import { listen, now } from "./store.js";

const PAD = { left: 48, right: 8, top: 22, bottom: 28 }; // px
const GRID = [15, 11]; // needles along b and along the modulus
const WITHIN = [0.01, 0.99]; // quantiles of the draws that the plane shows, at least
const LEAST = [1.6, 5]; // and factors from the fit, of b and of the modulus, within which a valley is seen
const LEVELS = [1, 2, 4]; // times the largest error within the tolerance of the fit
const SNAP = 40; // px from the valley
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
const PART = 1.05; // factor of the modulus, a key
const TICKS = [1, 2, 5].flatMap((one) => Array.from({ length: 14 }, (_, n) => one * 10 ** (n - 4))).sort((one, other) => one - other);
const always = { validOnly: false };

let words = ""; // what the plane that is shown says of this run

/** The scene of a needle at the end of its steps; null where there is no ridge. */
export function prepareRidge(needle) {
  return hasRidge(needle) ? { sentence: "Which b and μ fit equally well? Drag along the valley.", see: () => words, begin: makeRidge } : null;
}

/** Make the plane of the scene that is shown; other parameters than those of the point stay. */
async function makeRidge(into, kernel) {
  const { scene } = now;
  const { fitted, layer_names: names } = scene;
  const { key, symbol, unit, digits, throughout, value, step } = strengthOf(fitted);
  const drawn = readDraws(scene);
  const { b, mu, layer } = drawn;
  const origin = [value, fitted.layers[layer].mu_pa].map(Math.log);
  const tied = findTied(mu, layer)
  const modulus = modulusLike(fitted.layers[layer].mu_pa);
  const called = `μ ${names[layer] || `layer ${layer + 1}`}`;
  const ranges = [b, mu[layer]].map((values, i) => {
    const sorted = values.toSorted((one, other) => one - other);
    const [low, high] = WITHIN.map((share) => sorted[Math.round(share * (sorted.length - 1))]);
    return [Math.min(low, origin[i] - Math.log(LEAST[i])), Math.max(high, origin[i] + Math.log(LEAST[i]))];
  });
  const canvas = element("canvas", { className: "ridge", tabIndex: 0, ariaLabel: `${symbol}, and ${called} with it: up and down along the valley, left and right across` });
  canvas.setAttribute("role", "slider");
  const note = element("p", { className: "quiet" });
  into.replaceChildren(canvas, note);
  const context = canvas.getContext("2d");
  const current = () => [now.state.bevel[key], now.state.layers[layer].mu_pa].map(Math.log);
  const box = () => [[PAD.left, canvas.clientWidth - PAD.right], [canvas.clientHeight - PAD.bottom, PAD.top]];
  const toPx = (place) => box().map(([from, to], i) => from + ((place[i] - ranges[i][0]) / (ranges[i][1] - ranges[i][0])) * (to - from));
  const slope = findSlope(drawn); // the grid leans as the draws do: its columns lie along the valley
  const fromGrid = (place) => {
    const [at, height] = place.map((one, i) => ranges[i][0] + (one / (GRID[i] - 1)) * (ranges[i][1] - ranges[i][0]));
    return [at + slope * (height - origin[1]), height];
  };
  const clip = (place) => place.map((one, i) => Math.min(Math.max(one, ranges[i][0]), ranges[i][1]));

  const needle = await SteeredNeedle.begin(kernel, scene);
  for (const changes of listSteps(scene)) needle.apply(changes, always);
  const target = makeTarget(needle);
  const places = Array.from({ length: GRID[1] }, (_, row) => Array.from({ length: GRID[0] }, (_, column) => fromGrid([column, row])));
  const toStrength = (one) => (key === "offset_mm" ? Math.exp(one) : (Math.exp(one) * Math.PI) / 180);
  const rows = await computePlane(kernel, needle, target, {
    strengths: places.map((row) => row.map(([at]) => toStrength(at))), factors: places.map(([[, height]]) => Math.exp(height - origin[1])), tied,
  });
  const fit = compareWith(target, readPoints(needle.session, target.s));
  const level = Math.max(fit, Math.min(...rows.flat().filter((one) => one >= 0))) + equalWithin(scene);
  const valley = findValley(rows).map((found, row) => found && { place: fromGrid([found.column, row]), error: found.error });
  const contours = LEVELS.map((times) => findContour(rows, times * level).map((pair) => pair.map(fromGrid)));
  if (!canvas.isConnected) return;
  let [wanted, frame, held] = [null, 0, false];

  /** The b of the valley at a modulus, both logarithms; null beyond its ends. */
  function followValley(height) {
    const after = valley.findIndex((one) => one && one.place[1] >= height);
    const [one, other] = [valley[after - 1], valley[after]];
    if (!one || !other) return null;
    const share = (height - one.place[1]) / (other.place[1] - one.place[1]);
    return one.place[0] + share * (other.place[0] - one.place[0]);
  }

  /** The part of the valley about the fit within the tolerance of its error; null where there is none. */
  function findEqual() {
    const near = Math.round(((origin[1] - ranges[1][0]) / (ranges[1][1] - ranges[1][0])) * (GRID[1] - 1));
    const good = (at) => valley[at]?.error <= level;
    if (!good(near)) return null;
    let [from, to] = [near, near];
    while (good(from - 1)) from -= 1;
    while (good(to + 1)) to += 1;
    return from < to ? [valley[from].place, valley[to].place] : null;
  }

  const writeB = (one) => `${symbol} ${Math.exp(one).toFixed(digits)} ${unit}`;
  const writeModulus = (other) => `${modulus.write(Math.exp(other), 2)} ${modulus.unit}`;
  const what = `mean distance from the ${scene.measured ? "measured needle" : "needle of the fit"}`;
  const equal = findEqual();
  words = equal
    ? `${writeB(equal[0][0])} with ${called} ${writeModulus(equal[0][1])} fits as well as ${writeB(equal[1][0])} with ${writeModulus(equal[1][1])}: the ${what} is at most ${level.toFixed(2)} mm. One depth does not determine ${symbol} alone.`
    : `Away from the fit the ${what} exceeds ${level.toFixed(2)} mm, whatever ${called} is.`;
  write("see", words);

  /** The changes that bring b and the modulus to a place. */
  const listChanges = (place) => {
    const moved = place[1] - origin[1];
    return [[throughout, null, Math.exp(place[0])], ...tied.map((i) => ["mu_pa", i + 1, fitted.layers[i].mu_pa * Math.exp(moved)])];
  };

  /** Move the point once in a frame, within the plane. */
  function ask(place) {
    wanted = clip(place);
    frame ||= requestAnimationFrame(() => {
      frame = 0;
      steer([listChanges(wanted)]);
    });
  }

  /** Follow the pointer: near the valley along it. */
  function drag({ clientX, clientY }) {
    const { left, top } = canvas.getBoundingClientRect();
    const place = clip([clientX - left, clientY - top].map((px, i) => {
      const [from, to] = box()[i];
      return ranges[i][0] + ((px - from) / (to - from)) * (ranges[i][1] - ranges[i][0]);
    }));
    const at = followValley(place[1]);
    const away = at === null ? Infinity : Math.abs(toPx([at, 0])[0] - toPx(place)[0]);
    ask(away < SNAP ? [at, place[1]] : place);
  }

  /** The errors as colours, the least the deepest; drawn once, then stretched. */
  function paintErrors() {
    const cells = element("canvas", { width: GRID[0], height: GRID[1] });
    const painter = cells.getContext("2d");
    const most = LEVELS.at(-1) * level;
    rows.forEach((row, j) => row.forEach((error, i) => {
      painter.fillStyle = between(palette.band, palette.air, Number.isNaN(error) ? 1 : Math.min(Math.sqrt(error / most), 1));
      painter.fillRect(i, GRID[1] - 1 - j, 1, 1);
    }));
    return cells;
  }
  let cells = paintErrors();

  function draw() {
    if (!canvas.isConnected) return;
    const { clientWidth: width, clientHeight: height } = canvas;
    Object.assign(canvas, { width: width * devicePixelRatio, height: height * devicePixelRatio });
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    const [[left, right], [bottom, top]] = box();
    const [corner, along, up] = [[0, 0], [1, 0], [0, 1]].map((place) => toPx(fromGrid(place)));
    const [ex, ey] = [along, up].map((to) => to.map((px, i) => px - corner[i]));
    const begin = corner.map((px, i) => px - ex[i] / 2 + (GRID[1] - 0.5) * ey[i]); // cells lie about their places
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    context.fillStyle = palette.air;
    context.fillRect(left, top, right - left, bottom - top);
    context.save();
    context.transform(...ex, -ey[0], -ey[1], ...begin);
    faintly(context, 0.75, () => context.drawImage(cells, 0, 0));
    context.restore();
    contours.forEach((pairs, n) => segments(context, pairs.map((pair) => pair.map(toPx)), palette.label, n ? 0.75 : 1.5));
    faintly(context, 0.7, () => b.forEach((one, i) => {
      const [px, py] = toPx([one, mu[layer][i]]);
      context.fillStyle = palette.points;
      context.fillRect(px - 1, py - 1, 2, 2);
    }));
    trace(context, valley.filter((one) => one).map(({ place }) => toPx(place)));
    stroke(context, palette.ink, 2);
    context.restore();
    context.strokeStyle = palette.quiet;
    context.lineWidth = 1;
    context.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
    context.fillStyle = palette.label;
    setFont(context, "small", "left");
    context.fillText(`${called}, ${modulus.unit}`, 2, 9);
    setFont(context, "small", "right");
    context.fillText(`${symbol}, ${unit}`, right, bottom + 19);
    paintTicks(0, (one) => one, right - 40);
    paintTicks(1, (one) => modulus.read(one), Infinity);
    segments(context, cross(...toPx(origin), 5), palette.needle, 2);
    ring(context, ...toPx(current()), 7, palette.tip, palette.air);
  }

  /** Ticks and numbers along one axis, apart by 30 px at least. */
  function paintTicks(axis, read, end) {
    let last = -Infinity;
    for (const one of TICKS) {
      const at = Math.log(read(one));
      if (!(at >= ranges[axis][0] && at <= ranges[axis][1])) continue;
      const [px, py] = toPx(axis ? [ranges[0][0], at] : [at, ranges[1][0]]);
      if (Math.abs([px, py][axis] - last) < 30 || px > end) continue;
      last = [px, py][axis];
      segments(context, [[[px, py], axis ? [px - 4, py] : [px, py + 4]]], palette.quiet, 1);
      setFont(context, "small", axis ? "right" : "center");
      context.fillText(brief(one), px - (axis ? 6 : 0), py + (axis ? 0 : 11));
    }
  }

  function refresh() {
    if (!canvas.isConnected) return;
    const { bevel } = now.state;
    const error = now.scene.measured ? now.state.errors?.[now.scene.measured.metrics[0][0]] : distanceFromPinned();
    const [at, height] = current();
    const text = `${writeB(at)}, ${called} ${writeModulus(height)}: ${what} ${error == null ? "–" : `${error.toFixed(3)} mm`}`;
    const [least, most] = ranges[0].map((one) => Math.exp(one).toFixed(digits));
    Object.assign(canvas, { ariaValueMin: least, ariaValueMax: most, ariaValueNow: bevel[key].toFixed(digits), ariaValueText: text });
    write(note, `${text}. The cross is the fit; dots are draws, whose other parameters differ too.`);
    draw();
  }

  /** The mean distance, mm, of the needle from that of the fit, both as they are drawn. */
  function distanceFromPinned() {
    const { x, y } = now.state;
    const inserted = now.pinned ? x.map((_, i) => i).filter((i) => x[i] >= 0 && now.pinned.y[i] !== undefined) : [];
    return inserted.length ? mean(inserted.map((i) => Math.hypot(x[i] - now.pinned.x[i], y[i] - now.pinned.y[i]))) : null;
  }

  /** Up and down go along the valley by a part of the modulus, left and right across it by a step of b. */
  function press(event) {
    if (!(event.key in KEYS)) return;
    event.preventDefault();
    event.stopPropagation(); // here they do not move the needle
    const [across, along] = KEYS[event.key];
    const [at, from] = frame ? wanted : current();
    const to = from + along * Math.log(PART);
    const follows = (followValley(to) ?? at) - (followValley(from) ?? at); // as far from the valley as it was
    ask([along ? at + follows : Math.log(Math.max(Math.exp(at) + across * step, step)), to]);
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
    keydown: press,
  };
  for (const [kind, hear] of Object.entries(heard)) canvas.addEventListener(kind, hear);
  refreshShown = refresh;
  drawShown = () => {
    cells = paintErrors();
    draw();
  };
  refresh();
}

let [refreshShown, drawShown] = [() => {}, () => {}]; // of the plane that is shown
listen("state", () => refreshShown());
onScheme(() => requestAnimationFrame(drawShown));
