"""What goes to stdout: tables for people, JSON for machines."""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def say(text: str = "") -> None:
    """Print a line of the result."""
    print(text)


def note(text: str) -> None:
    """Print a line that is no result to stderr."""
    print(text, file=sys.stderr)


def show_json(value: object) -> None:
    """Print a value as JSON; numbers that JSON has not (NaN, infinity) become null."""
    print(json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False))


def show_table(columns: Sequence[str], rows: Iterable[Sequence[object]], title: str = "") -> None:
    """Print a table; numbers are right-aligned, missing ones empty, and nothing is cut off in a pipe."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    cells = [[_cell(value) for value in row] for row in rows]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        right = any(row[number][1] for row in cells)
        table.add_column(Text(column), justify="right" if right else "left", overflow="fold")
    for row in cells:
        table.add_row(*(Text(text) for text, _ in row))
    if title:
        print(title)
    Console(width=None if sys.stdout.isatty() else 1000).print(table)


def show_frame(frame: Any, title: str = "") -> None:  # noqa: ANN401  a pandas.DataFrame, not imported here
    """Print a DataFrame as a table."""
    show_table([str(name) for name in frame.columns], frame.itertuples(index=False), title)


def _cell(value: object) -> tuple[str, bool]:
    """Return a cell's text, and whether it is a number."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "", False
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value), False
    return (f"{value:.4g}" if isinstance(value, float) else str(value)), True


def _plain(value: object) -> object:
    """Return the value in JSON's own types."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return _plain(value.tolist())
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, str | int | bool) or value is None else str(value)
