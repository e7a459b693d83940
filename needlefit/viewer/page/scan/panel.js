/** The lists of what was found, and the verdict. */

import { button, element, part } from "../dom.js";

const shown = (value, digits = 2) => value.toFixed(digits);
const cell = (tag, [content = "", kind = ""]) => element(tag, { className: kind }, content);

function table(heads, rows) {
  const head = heads.map(([name, kind]) => (name ? cell("th", [name, kind]) : cell("td", [])));
  return element("table", {}, element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows));
}

const row = (cells, className = "") => element("tr", { className }, cells.map((one) => cell("td", one)));
const press = (text, act, label = text) => button(text, act, { className: "small", ariaLabel: label });
const quiet = (text, more = "") => element("p", { className: `quiet ${more}`.trim() }, text);
const written = (at) => at.map((x, n) => `${"LPS"[n]} ${x.toFixed(1)}`).join(", ");
const key = (kind) => element("i", { className: `key ${kind}` });

/** Say what became of the scan. */
export function showVerdict(state) {
  const { found } = state;
  const place = part("verdict");
  place.classList.toggle("refused", Boolean(found.error));
  const lines = found.error ? refusal(found.error) : [success(found)];
  place.replaceChildren(...lines.map((content) => element("p", {}, content)));
}

function refusal({ what, where, expected, fix }, verdict = "Refused") {
  const more = [where, expected && `expected: ${expected}`].filter(Boolean).join("; ");
  const lines = [element("strong", {}, `${verdict}: ${what}.`), more, fix && `To go on: ${fix}.`];
  return lines.filter(Boolean);
}

function success({ inserted, warnings }) {
  const count = warnings.length;
  const made = element("strong", {}, `Reconstructed: inserted ${shown(inserted.depth)} ± ${shown(inserted.sd)} mm`);
  if (!count) return [made, "."];
  return [made, "; ", element("a", { href: "#note-part" }, `${count} ${count === 1 ? "warning" : "warnings"}`), "."];
}

/** Say that corrections wait to be used. */
export function showWaiting(waiting) {
  part("verdict").querySelector(".waiting")?.remove();
  if (waiting) part("verdict").append(element("p", { className: "waiting" }, "The corrections are not yet used: reconstruct again."));
}

/** Show every list; `act` has what their buttons do. */
export function showLists(state, act) {
  const { found } = state;
  part("needles").replaceChildren(needles(found, act), ...placedNeedle(state.corrections.needle));
  part("ends").replaceChildren(ends(state, act));
  part("ball-part").hidden = !found.has_markers;
  part("balls").replaceChildren(balls(state, act));
  part("layer-part").hidden = !found.layers.length && !found.proposed.length;
  part("layers").replaceChildren(layers(found, act));
  part("note-part").hidden = !found.warnings.length;
  part("notes").replaceChildren(...found.warnings.map((text) => element("li", {}, text)));
}

function needles(found, act) {
  if (!found.tubes.length) return quiet("Nothing is as bright as metal.");
  const rows = found.tubes.map((one, n) =>
    row(
      [
        [[key(one.chosen ? "needle" : "other"), one.chosen ? "needle" : "other tube"]],
        [`${shown(one.length, 1)} × ${shown(one.width, 1)} mm`, "n"],
        [[press("show", () => act.look(one.middle), `show tube ${n + 1}`),
          one.chosen ? "" : press("take", () => act.correct({ needle: one.middle }), `take tube ${n + 1} for the needle`)], "do"],
      ],
      one.chosen ? "chosen" : "",
    ),
  );
  return table([["tube"], ["length × width", "n"], [""]], rows);
}

function placedNeedle(at) {
  if (!at) return [];
  return [quiet(`By hand: the tube at ${written(at)} mm.`, "by-hand")];
}

function ends(state, act) {
  const { found } = state;
  const rows = [];
  for (const [name, kind, one] of [["entry", "contact", found.contact], ["tip", "tip", found.tip]]) {
    const given = state.corrections[kind];
    const place = given ?? one?.at;
    const used = one?.placed ?? false;
    const source = given ? (used ? "by hand" : "by hand, not yet used") : (one && ORIGINS[one.source]) ?? (one ? "found" : "not found");
    rows.push(
      row([
        [[key(kind), name]],
        [element("span", { className: given ? "by-hand" : "" }, source)],
        [one && (used || !given) ? `± ${shown(one.along_sd)} mm` : "", "n"],
        [place ? press("show", () => act.look(place), `show the ${name}`) : "", "do"],
      ]),
    );
  }
  const parts = [table([[""], [""], ["along needle", "n"], [""]], rows)];
  if (found.entries.length > 1) parts.push(quiet("Places where the tissue may begin:"), entries(found, act));
  return element("div", {}, parts);
}

const ORIGINS = { stage: "stated (stage)" };
const SAME_PLACE_MM = 0.5;

function entries(found, act) {
  const taken = (one) => found.contact && Math.hypot(...one.at.map((x, n) => x - found.contact.at[n])) < SAME_PLACE_MM;
  const rows = found.entries.map((one, n) =>
    row(
      [
        [one.change === "rise" ? "after air" : "in tissue"],
        [`${shown(one.depth)} ± ${shown(one.sd)} mm`, "n"],
        [[press("show", () => act.look(one.at), `show place ${n + 1}`),
          found.entry_stated || taken(one) ? "" : press("take", () => act.correct({ contact: one.at }), `take place ${n + 1} for the entry`)], "do"],
      ],
      taken(one) ? "chosen" : "",
    ),
  );
  return table([[""], ["before the tip", "n"], [""]], rows);
}

function balls(state, act) {
  const list = state.balls();
  const least = state.found.min_balls;
  const few = list.length < least ? [element("p", { className: "by-hand" }, `${list.length} of at least ${least} balls: add the others.`)] : [];
  if (!list.length) return element("div", {}, few);
  const rows = list.map((one, n) =>
    row([
      [[key("ball"), String(n + 1)]],
      [one.sd === undefined ? "by hand, not yet used" : `± ${shown(one.sd, 3)} mm`, "n"],
      [one.residual === undefined || one.residual === null ? "—" : `${shown(one.residual)} mm`, "n"],
      [[press("show", () => act.look(one.at), `show ball ${n + 1}`), press("remove", () => act.remove(n), `remove ball ${n + 1}`)], "do"],
    ]),
  );
  return element("div", {}, table([["ball"], ["centre", "n"], ["residual", "n"], [""]], rows), few);
}

function layers(found, act) {
  const rows = found.layers.map((one, n) =>
    row([
      [[key("layer"), `boundary ${n + 1}`]],
      [`${shown(one.depth)} ± ${shown(one.sd)} mm`, "n"],
      [press("show", () => act.look(one.at), `show boundary ${n + 1}`), "do"],
    ]),
  );
  const proposed = found.proposed.map((one, n) =>
    row([
      [[key("proposed"), `proposed ${n + 1}`]],
      [`${shown(one.depth)} ± ${shown(one.sd)} mm`, "n"],
      [press("show", () => act.look(one.at), `show proposed boundary ${n + 1}, a step of ${one.step.toFixed(0)} HU`), "do"],
    ]),
  );
  return table([[""], ["depth", "n"], [""]], [...rows, ...proposed]);
}

/** Say where corrections were saved, and how to go on. */
export function showSaved(state, { table: path, command }) {
  showVerdict(state);
  const repeat = element("p", {}, "To repeat it: ", element("code", {}, command));
  part("verdict").append(element("p", {}, `Saved: ${path}`), repeat);
}

/** Show what kept something from being done. */
export function showFault(reason, verdict) {
  const place = part("verdict");
  place.classList.add("refused");
  place.replaceChildren(...refusal(reason, verdict).map((content) => element("p", {}, content)));
}
