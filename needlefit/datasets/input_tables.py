"""The columns of tables that users write, as `input_tables.csv` beside this module describes them."""

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True)
class InputColumn:
    """A column of a table that users write, or several of one meaning, with commas."""

    table: str  #: the name of its file
    column: str
    meaning: str
    default: str  #: what an empty cell means


@cache
def read_input_columns() -> tuple[InputColumn, ...]:
    text = files(__package__).joinpath("input_tables.csv").read_text(encoding="utf-8")
    return tuple(InputColumn(**row) for row in csv.DictReader(text.splitlines()))
