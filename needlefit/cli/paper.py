"""`needlefit paper`: the published tables, and where they contradict each other."""

import dataclasses
from typing import TYPE_CHECKING

from needlefit.cli import options, screen

if TYPE_CHECKING:
    import pandas as pd

    from needlefit.reporting.table_layout import TableColumn, TableLayout


def paper(json: options.Json = False, verbose: options.Verbose = False) -> None:
    """Print the paper's tables and the list of its contradictions."""
    from needlefit.studies import paper as published

    contradictions = published.find_contradictions()
    if json:
        rows: dict[str, object] = {
            name: published.read_published_table(name).to_dict("records") for name in published.TABLE_TITLES
        }
        screen.show_json({**rows, "contradictions": [dataclasses.asdict(claim) for claim in contradictions]})
        return
    screen.print_text(
        f"The paper contradicts itself in {len(contradictions)} places, listed below its tables."
    )
    screen.print_line()
    for name, title in published.TABLE_TITLES.items():
        screen.show_display(_lay_out(name, title, published.read_printed_table(name)), notes=False)
    screen.print_line(f"Contradictions ({len(contradictions)})")
    for number, claim in enumerate(contradictions, start=1):
        screen.print_text(f"{number:3}. {claim.sentence}")


def _lay_out(name: str, title: str, printed: "pd.DataFrame") -> "TableLayout":
    """Return a published table: numbers as printed, headings as everywhere else."""
    from needlefit.reporting.table_layout import TableLayout

    columns = tuple(_find_head(str(key), printed[key]) for key in printed)
    cells = printed.apply(lambda column: column.str.replace("_", " "))
    return TableLayout(name, title, columns, tuple(cells.itertuples(index=False, name=None)))


_ROLES = {"tune_": "Fitted: ", "validate_": "Held out: "}


def _find_head(key: str, cells: "pd.Series[str]") -> "TableColumn":
    import pandas as pd

    from needlefit.reporting.columns import find_column
    from needlefit.reporting.table_layout import TableColumn

    role = next((prefix for prefix in _ROLES if key.startswith(prefix)), "")
    column = find_column(key.removeprefix(role))
    label = f"{_ROLES[role]}{column.label.lower()}" if role else column.label
    is_number = pd.to_numeric(cells.replace("", "0"), errors="coerce").notna().all()
    return TableColumn(label, column.unit, "right" if is_number else "left")
