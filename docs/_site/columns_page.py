"""Every column of the tables that needlefit reads and writes, and the words of the interactive simulation."""

import re
from collections.abc import Iterator
from importlib.resources import files
from itertools import groupby

from pages import keep
from sphinx.application import Sphinx

from needlefit.datasets.input_tables import read_input_columns
from needlefit.metrics import list_metrics
from needlefit.reporting.columns import METRIC_UNIT, Column, list_columns

PAGE = "reference/columns.md"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", lambda app: keep(app.srcdir / PAGE, "\n".join(_page()) + "\n"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _page() -> Iterator[str]:
    columns = list_columns().values()
    yield "# Columns of tables\n\n`needlefit explain te_mm` prints one. `{k}`: the number of a layer.\n"
    yield "## Error metrics\n\nValues of the column `metric`, and columns of tables of single insertions.\n"
    yield "| name | symbol | unit | meaning |\n|---|---|---|---|"
    yield from (f"| `{one.name}` | {one.label} | {one.unit} | {one.explanation} |" for one in list_metrics())
    for title, where in (("Columns of files", ""), ("Columns of printed tables alone", "print")):
        yield f"\n## {title}\n\n| column | heading | unit | meaning |\n|---|---|---|---|"
        yield from (_row(one) for one in columns if one.where == where)
    for table, members in groupby(read_input_columns(), lambda one: one.table):
        yield f"\n## `{table}`, which you write\n\n| column | meaning | an empty cell |\n|---|---|---|"
        yield from (f"| `{one.column}` | {one.meaning} | {one.default} |" for one in members)
    yield "\n## On the page of the interactive simulation\n\n| word | meaning |\n|---|---|"
    script = files("needlefit.viewer").joinpath("page/definitions.js").read_text(encoding="utf-8")
    for word, meaning in re.findall(r'^  "([^"]+)": "([^"]+)",$', script, re.MULTILINE):
        yield f"| {word} | {meaning} |"


def _row(column: Column) -> str:
    unit = column.unit.replace(METRIC_UNIT, "of the metric")
    return f"| `{column.key}` | {column.heading} | {unit} | {column.explanation} |"
