/** The lists of what was found, and the verdict. */

const byId = (name) => document.getElementById(name);
const shown = (value, digits = 2) => (value === null || value === undefined ? "—" : value.toFixed(digits));

function element(tag, content = "", properties = {}) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...[content].flat());
  return made;
}

function table(heads, rows) {
  const head = element("tr", heads.map(([name, kind]) => element("th", name, { className: kind ?? "", scope: "col" })));
  return element("table", [element("thead", head), element("tbody", rows)]);
}

const row = (cells, className = "") =>
  element("tr", cells.map(([content, kind]) => element("td", content, { className: kind ?? "" })), { className });

function button(text, act, label = text) {
  const made = element("button", text, { type: "button", className: "small" });
  made.setAttribute("aria-label", label);
  made.addEventListener("click", act);
  return made;
}

const key = (kind) => element("i", "", { className: `key ${kind}` });

/** Say what became of the scan. */
export function showVerdict(state) {
  const { found } = state;
  const place = byId("verdict");
  place.classList.toggle("refused", Boolean(found.error));
  const lines = found.error ? refusal(found.error) : [success(found)];
  place.replaceChildren(...lines.map((content) => element("p", content)));
}

function refusal({ what, where, expected, fix }) {
  const more = [where, expected && `expected: ${expected}`].filter(Boolean).join("; ");
  const lines = [element("strong", `Refused: ${what}.`), more, fix && `To go on: ${fix}.`];
  return lines.filter(Boolean);
}

function success({ inserted, warnings }) {
  const count = warnings.length;
  const noted = count ? `; ${count} ${count === 1 ? "warning" : "warnings"}` : "";
  return element("strong", `Reconstructed: inserted ${shown(inserted.depth)} ± ${shown(inserted.sd)} mm${noted}.`);
}

/** Show every list; `act` has what their buttons do. */
export function showLists(state, act) {
  const { found } = state;
  byId("needles").replaceChildren(needles(found, act));
  byId("ends").replaceChildren(ends(state, act));
  byId("ball-part").hidden = !found.has_markers;
  byId("balls").replaceChildren(balls(state, act));
  byId("layer-part").hidden = !found.layers.length;
  byId("layers").replaceChildren(layers(found, act));
  byId("note-part").hidden = !found.warnings.length;
  byId("notes").replaceChildren(...found.warnings.map((text) => element("li", text)));
}

function needles(found, act) {
  if (!found.tubes.length) return element("p", "Nothing is as bright as metal.", { className: "quiet" });
  const rows = found.tubes.map((one, n) =>
    row(
      [
        [one.chosen ? [key("needle"), "needle"] : "not the needle"],
        [shown(one.length, 1), "n"],
        [shown(one.width, 1), "n"],
        [[button("show", () => act.look(one.middle), `show tube ${n + 1}`),
          one.chosen ? "" : button("take", () => act.correct({ needle: one.middle }), `take tube ${n + 1} for the needle`)]],
      ],
      one.chosen ? "chosen" : "",
    ),
  );
  return table([["tube"], ["length", "n"], ["width", "n"], [""]], rows);
}

function ends(state, act) {
  const { found } = state;
  const rows = [];
  for (const [name, kind, one] of [["entry", "contact", found.contact], ["tip", "tip", found.tip]]) {
    const given = state.corrections[kind];
    const place = given ?? one?.at;
    const source = given ? "by hand" : one ? (one.placed ? "by hand" : "found") : "not found";
    rows.push(
      row([
        [[key(kind), name]],
        [element("span", source, { className: source === "by hand" ? "by-hand" : "" })],
        [one ? `± ${shown(one.along_sd)}` : "", "n"],
        [place ? button("show", () => act.look(place), `show the ${name}`) : ""],
      ]),
    );
  }
  const parts = [table([[""], [""], ["along", "n"], [""]], rows)];
  if (found.entries.length > 1) parts.push(element("p", "Places where soft material begins:", { className: "quiet" }), entries(found, act));
  return element("div", parts);
}

function entries(found, act) {
  const rows = found.entries.map((one, n) =>
    row([
      [one.change === "rise" ? "from air" : "a step"],
      [`${shown(one.depth)} ± ${shown(one.sd)}`, "n"],
      [[button("show", () => act.look(one.at), `show place ${n + 1}`),
        button("take", () => act.correct({ contact: one.at }), `take place ${n + 1} for the entry`)]],
    ]),
  );
  return table([[""], ["before the tip", "n"], [""]], rows);
}

function balls(state, act) {
  const list = state.balls();
  if (!list.length) return element("p", "None was found.", { className: "quiet" });
  const rows = list.map((one, n) =>
    row([
      [[key("ball"), String(n + 1)]],
      [one.sd === undefined ? "by hand" : `± ${shown(one.sd, 3)}`, "n"],
      [shown(one.residual), "n"],
      [[button("show", () => act.look(one.at), `show ball ${n + 1}`), button("remove", () => act.remove(n), `remove ball ${n + 1}`)]],
    ]),
  );
  return table([["ball"], ["centre", "n"], ["residual", "n"], [""]], rows);
}

function layers(found, act) {
  const rows = found.layers.map((one, n) =>
    row([
      [[key("layer"), `boundary ${n + 1}`]],
      [`${shown(one.depth)} ± ${shown(one.sd)}`, "n"],
      [button("show", () => act.look(one.at), `show boundary ${n + 1}`)],
    ]),
  );
  return table([[""], ["depth", "n"], [""]], rows);
}

/** Say where corrections were saved, and how to go on. */
export function showSaved({ table: path, command }) {
  byId("saved-part").hidden = false;
  byId("saved").replaceChildren(element("p", path, { className: "quiet" }), element("code", command));
}

/** Show what kept something from being done. */
export function showFault(reason) {
  const place = byId("verdict");
  place.classList.add("refused");
  place.replaceChildren(...refusal(reason).map((content) => element("p", content)));
}
