/** The lists of what was found, and the verdict. */

import { button, element, part } from "../dom.js";

const SAME_PLACE_MM = 0.5;
const ORIGINS = { stage: "stated (stage)" };

const mm = (value, digits = 2) => `${value.toFixed(digits)} mm`;
const within = ({ depth, sd }) => `${depth.toFixed(2)} ± ${mm(sd)}`;
const apart = (one, other) => Math.hypot(...one.map((x, n) => x - other[n]));
const quiet = (text, more = "") => element("p", { className: `quiet ${more}`.trim() }, text);
const byHand = (text) => element("p", { className: "by-hand" }, text);
const key = (kind) => element("i", { className: `key ${kind}` });
const cell = (content = "", className = "", tag = "td") => element(tag, { className }, content);
const press = (text, ariaLabel, act) => button(text, act, { className: "small", ariaLabel });

/** A row: what it is about, other cells (numbers as texts), and what can be done with it. */
function row(about, cells, buttons, chosen = false) {
  const numbers = cells.map((one) => (typeof one === "string" ? cell(one, "n") : cell(one)));
  return element("tr", { className: chosen ? "chosen" : "" }, cell(about), numbers, cell(buttons, "do"));
}

function table(heads, rows) {
  const head = heads.map(([name, kind]) => (name ? cell(name, kind, "th") : cell()));
  return element("table", {}, element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows));
}

export function showVerdict({ found: { examined, error, refusal, inserted, warnings }, isRefused }) {
  if (!examined) return part("verdict").replaceChildren("Examining the scan …");
  if (isRefused()) return showFault(refusal, "Refused, and the former result stays");
  if (error) return showFault(error, "Refused");
  const made = element("strong", {}, `Reconstructed: inserted ${within(inserted)}`);
  const count = `${warnings.length} ${warnings.length === 1 ? "warning" : "warnings"}`;
  const more = warnings.length ? ["; ", element("a", { href: "#note-part" }, count)] : [];
  part("verdict").classList.remove("refused");
  part("verdict").replaceChildren(element("p", {}, made, more, "."));
}

/** Show what kept something from being done. */
export function showFault({ what, where, expected, fix }, verdict) {
  const more = [where, expected && `expected: ${expected}`].filter(Boolean).join("; ");
  const lines = [element("strong", {}, `${verdict}: ${what}.`), more, fix && `To go on: ${fix}.`].filter(Boolean);
  part("verdict").classList.add("refused");
  part("verdict").replaceChildren(...lines.map((content) => element("p", {}, content)));
}

/** Say where corrections were saved, and how to go on. */
export function showSaved(state, { table: path, command, refused }) {
  showVerdict(state);
  const repeat = element("p", {}, "To repeat it: ", element("code", {}, command));
  const note = refused ? "; with these corrections the scan is still refused, also by this command" : "";
  part("verdict").append(element("p", {}, `Saved: ${path}${note}`), repeat);
}

export function showWaiting(waiting) {
  part("verdict").querySelector(".waiting")?.remove();
  if (waiting) part("verdict").append(element("p", { className: "waiting" }, "The corrections are not yet used: reconstruct again."));
}

/** Show every list; `act` has what their buttons do. */
export function showLists(state, act) {
  const { found, corrections } = state;
  const show = (at, what) => press("show", `show ${what}`, () => act.look(at));
  const take = (change, what) => press("take", `take ${what}`, () => act.correct(change));

  const tubes = found.tubes.map(({ chosen, length, width, middle }, n) => row(
    [key(chosen ? "needle" : "other"), chosen ? "needle" : "other tube"], [`${length.toFixed(1)} × ${mm(width, 1)}`],
    [show(middle, `tube ${n + 1}`), chosen ? "" : take({ needle: middle, points: null }, `tube ${n + 1} for the needle`)], chosen,
  ));
  const [placed, points] = [corrections.needle, corrections.points ?? []];
  const rest = (n) => (points.length > 1 ? points.toSpliced(n, 1) : null);
  const along = points.map((at, n) => row(
    [key("needle"), `point ${n + 1}`], [],
    [show(at, `point ${n + 1}`), press("remove", `remove point ${n + 1}`, () => act.correct({ points: rest(n) }))],
  ));
  part("needles").replaceChildren(
    tubes.length ? table([["tube"], ["length × width", "n"], [""]], tubes) : quiet("Nothing is as bright as metal."),
    ...(along.length ? [table([["by hand"], [""]], along)] : []),
    ...(along.length && along.length < found.min_points ? [byHand(`At least ${found.min_points} points.`)] : []),
    ...(placed ? [quiet(`By hand: the tube at ${placed.map((x, n) => `${"LPS"[n]} ${x.toFixed(1)}`).join(", ")} mm.`, "by-hand")] : []),
  );

  const ends = [["entry", "contact"], ["tip", "tip"]].map(([name, kind]) => {
    const [one, given] = [found[kind], corrections[kind]];
    const [at, used] = [given ?? one?.at, one?.placed ?? false];
    const where = one ? ORIGINS[one.source] ?? "found" : "not found";
    const source = given ? `by hand${used ? "" : ", not yet used"}` : where;
    const sd = one && (used || !given) ? `± ${mm(one.along_sd)}` : "";
    return row([key(kind), name], [[element("span", { className: given ? "by-hand" : "" }, source)], sd], at ? show(at, `the ${name}`) : "");
  });
  const isEntry = ({ at }) => found.contact && apart(at, found.contact.at) < SAME_PLACE_MM;
  const entries = found.entries.map((one, n) => row(
    one.change === "rise" ? "after air" : "in tissue", [within(one)],
    [show(one.at, `place ${n + 1}`), found.entry_stated || isEntry(one) ? "" : take({ contact: one.at }, `place ${n + 1} for the entry`)],
    isEntry(one),
  ));
  const more = [quiet("Places where the tissue may begin:"), table([[""], ["before the tip", "n"], [""]], entries)];
  const ways = [table([[""], [""], ["along needle", "n"], [""]], ends), ...(entries.length > 1 ? more : [])];
  part("ends").replaceChildren(element("div", {}, ways));

  const balls = state.balls().map(({ at, sd, residual }, n) => row(
    [key("ball"), String(n + 1)],
    [sd === undefined ? "by hand" : `± ${mm(sd, 3)}`, residual === undefined || residual === null ? "—" : mm(residual)],
    [show(at, `ball ${n + 1}`), press("remove", `remove ball ${n + 1}`, () => act.remove(n))],
  ));
  const least = found.min_balls;
  const candidates = found.candidates.filter(({ at }) => !state.balls().some((one) => apart(one.at, at) < SAME_PLACE_MM));
  const others = candidates.map(({ at, diameter }, n) => row(
    [key("candidate"), `${diameter.toFixed(1)} mm wide`], [],
    [show(at, `candidate ${n + 1}`), press("add", `add candidate ${n + 1}`, () => act.add([at]))],
  ));
  const these = () => act.add(candidates.map(({ at }) => at));
  const alike = [quiet("About as large, but not taken for balls:"), table([[""], [""]], others),
    press("use these", "use these candidates as balls", these)];
  part("ball-part").hidden = !found.has_markers;
  part("balls").replaceChildren(element("div", {},
    balls.length ? [table([["ball"], ["centre", "n"], ["residual", "n"], [""]], balls)] : [],
    balls.length < least ? byHand(`${balls.length} of at least ${least} balls: add the others.`) : [],
    others.length && found.error ? alike : [],
  ));

  const layers = found.layers.map((one, n) => row([key("layer"), `boundary ${n + 1}`], [within(one)], show(one.at, `boundary ${n + 1}`)));
  const proposed = found.proposed.map((one, n) => row(
    [key("proposed"), `proposed ${n + 1}`], [within(one)], show(one.at, `proposed boundary ${n + 1}, a step of ${one.step.toFixed(0)} HU`),
  ));
  part("layer-part").hidden = !layers.length && !proposed.length;
  part("layers").replaceChildren(table([[""], ["depth", "n"], [""]], [...layers, ...proposed]));
  part("note-part").hidden = !found.warnings.length;
  part("notes").replaceChildren(...found.warnings.map((text) => element("li", {}, text)));
}
