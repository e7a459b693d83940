"""Read what cells of tables state: numbers, and what each needle or all of them have of their own."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.answers import Stated, add_stated
from needlefit.datasets.importing.curves import ATTRIBUTES
from needlefit.datasets.importing.synonyms import find_meaning
from needlefit.datasets.importing.table_heads import COLUMNS_FIX, VECTORS, ColumnGroup
from needlefit.datasets.importing.tables import CellTable
from needlefit.errors import refusal


def read_numbers(cells: CellTable, rows: Sequence[int], columns: Sequence[int]) -> Floats:
    """Return the numbers in some columns (N, M); DataError at the first cell that is none."""
    values = np.zeros((len(rows), len(columns)))
    for (k, n), (i, m) in product(enumerate(rows), enumerate(columns)):
        if (number := cells.number(text := cells.cell(n, m))) is None:
            raise refusal(f"""a number is {text[:40]!r}
                expected: numbers with a decimal {"comma" if cells.decimal == "," else "point"}
                fix: correct the cell; to leave the point out, empty all coordinates of its row
                where: {cells.where(n, m)}""")
        values[k, i] = number
        cells.use(n, m)
    return values


def read_attributes(cells: CellTable, group: ColumnGroup, rows: Sequence[int]) -> dict[str, Stated]:
    """Return what columns state once for the curve in some rows, of `ATTRIBUTES`.

    DataError if two cells of one column contradict each other.
    """
    stated: dict[str, Stated] = {}
    for meaning in ATTRIBUTES:
        columns = group.find(meaning)
        for m in columns:
            texts = {n: text for n in rows if (text := cells.cell(n, m))}
            first = next(iter(texts), 0)
            other = next((n for n, text in texts.items() if text != texts[first]), None)
            if other is not None and meaning not in ("depth", "point sd"):  # those of each reading
                raise refusal(f"""{meaning} is {texts[first][:40]!r} and {texts[other][:40]!r}
                    expected: one value
                    fix: correct the cell; if other columns distinguish the needles, {COLUMNS_FIX}
                    where: {cells.where(other, m)}""")
            if not texts or other is not None:
                continue
            own, join = [m], ""
            if meaning in VECTORS or meaning == "boundaries":  # of several columns
                own, join = columns, ", " if meaning in VECTORS else "; "
            parts = [_clean(cells, text, meaning) for k in own if (text := cells.cell(first, k))]
            for n in texts:
                cells.use(n, *own)
            one = Stated(join.join(parts), group.headers[m].unit, cells.where(first, own[0]))
            # `material` is that of the needle where the table of words has its modulus
            is_of_needle = meaning == "medium" and find_meaning("value", one.text).endswith("GPa")
            add_stated(stated, {"modulus" if is_of_needle else meaning: one})
    return stated


def _clean(cells: CellTable, text: str, meaning: str) -> str:
    """Return a cell of what has a unit with a decimal point, where it is a number with a comma."""
    is_name = meaning in ("medium", "specimen", "bevel side")
    if is_name or cells.decimal != "," or cells.number(text) is None:
        return text
    return text.replace(".", "").replace(",", ".")
