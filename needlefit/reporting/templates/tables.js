// Sortable tables: a click on a heading sorts its rows, a second one the other way round.
(() => {
  const raised = { "⁻": "-", "⁰": "0", "¹": "1", "²": "2", "³": "3", "⁴": "4", "⁵": "5", "⁶": "6", "⁷": "7", "⁸": "8", "⁹": "9" };
  const number = (text) => {
    const plain = text.replace(/−/g, "-").replace(/ × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)/, (_, power) => "e" + [...power].map((c) => raised[c]).join(""));
    const value = parseFloat(plain.replace(/^[^0-9+-]+(?=\d)/, ""));
    return Number.isNaN(value) ? null : value;
  };
  const compare = (a, b) => {
    const [x, y] = [number(a), number(b)];
    if (x !== null && y !== null) return x - y;
    if (x !== null || y !== null) return x === null ? 1 : -1;
    return a.localeCompare(b, "en");
  };
  const fill = (body) => { // rows of a group show its name once; sorted, each row needs it
    let above = [];
    for (const row of body.rows) {
      [...row.cells].forEach((cell, i) => {
        if (cell.textContent === "" && cell.classList.contains("left") && above[i]) cell.textContent = above[i];
      });
      above = [...row.cells].map((cell) => cell.textContent);
      row.classList.remove("rule");
    }
  };
  const sort = (table, column) => {
    const body = table.tBodies[0], heads = [...(table.tHead?.rows[0].cells ?? [])];
    const up = heads[column].getAttribute("aria-sort") !== "ascending";
    if (!table.dataset.filled) { fill(body); table.dataset.filled = "yes"; }
    heads.forEach((head) => head.removeAttribute("aria-sort"));
    heads[column].setAttribute("aria-sort", up ? "ascending" : "descending");
    const rows = [...body.rows].sort((a, b) => compare(a.cells[column].textContent, b.cells[column].textContent));
    body.append(...(up ? rows : rows.reverse()));
  };
  /** @type {NodeListOf<HTMLTableElement>} */
  const tables = document.querySelectorAll("main figure table");
  for (const table of tables) {
    [...(table.tHead?.rows[0].cells ?? [])].forEach((head, column) => {
      head.tabIndex = 0;
      head.title = "Sort";
      head.addEventListener("click", () => sort(table, column));
      head.addEventListener("keydown", (event) => {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); sort(table, column); }
      });
    });
  }
})();
