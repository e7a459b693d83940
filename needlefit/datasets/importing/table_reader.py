"""Read one table: its curves, what it states of needles, and what of it is not used."""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import count, pairwise
from pathlib import Path

from needlefit.datasets.importing.curves import ImportContent
from needlefit.datasets.importing.synonyms import Header
from needlefit.datasets.importing.table_curves import CurveReader
from needlefit.datasets.importing.table_heads import NO_POINTS, find_heads
from needlefit.datasets.importing.table_needles import MAX_LISTED_CHARS, read_needles, read_shared
from needlefit.datasets.importing.tables import CellTable, UnclearColumnsError

_QUANTITY = re.compile(r"\D{0,3}[-+]?\d+([.,]\d+)?\s*\S{0,4}")  # a number with a unit: 22G, 0,7 mm
MAX_LISTED_MARKS = 4  # of a column that marks rows
UNKNOWN_DOUBT = "numbers, unknown header: --columns MEANING=HEADER, or unrelated=HEADER"
EXCLUSION_DOUBT = "all rows are used: delete those to leave out, or state --columns unrelated=HEADER"


def read_table(cells: CellTable, content: ImportContent) -> None:
    """Add the curves in a table, or what it states of needles; curves without a name have that of the table.

    A table of which nothing states which columns are coordinates is left out. UnclearLayoutError if a needle
    may stand in a row or in columns. DataError if a cell of a known column is not understood.
    """
    heads = find_heads(cells, content)
    headers = {n: groups[0].headers for n, groups in heads.items()}
    curves = list(CurveReader(cells, content, heads).read())
    try:
        if not heads and not read_shared(cells, content):
            group = read_needles(cells, content)
            headers[group.row] = group.headers
    except UnclearColumnsError as error:
        name = f"sheet {cells.sheet}" if cells.sheet else f"file {cells.path.name}"
        content.unused.append((name, error.what))
        content.left_out[name, error.what] = cells
        content.unclear.append(error)
        return
    stem, unnamed = cells.sheet or cells.path.name.split(".")[0] or cells.path.stem, count(1)
    for one in curves:
        one.is_named = bool(one.name)
        one.name = one.name or (f"{stem}-{next(unnamed)}" if len(curves) > 1 else stem)
    content.curves += curves
    _add_unused(cells, content, headers)


def _add_unused(cells: CellTable, content: ImportContent, heads: dict[int, Sequence[Header]]) -> None:
    """Add what is not used: columns by their headers, and other cells by their rows.

    A column of numbers under a header that no language knows may hold something that matters.
    """
    starts = sorted(heads)
    for n, end in pairwise([*starts, len(cells.rows)]):
        for m, header in enumerate(heads[n]):
            texts = {(k, m): cells.cell(k, m) for k in range(n + 1, end) if cells.cell(k, m)}
            if not texts or texts.keys() & cells.used:
                continue
            cells.used.update(texts)
            one = f"column {header.text or m + 1}", Path(cells.where(max(n, 0))).name
            numbers = [cells.number(text) for text in texts.values()]
            is_known = bool(header.meaning) or header.group in NO_POINTS
            is_count = not header.text and numbers == [*range(1, len(numbers) + 1)]
            is_quantity = all(_QUANTITY.fullmatch(text) for text in texts.values())
            if header.meaning == "exclusion" and (counts := _count_marks(cells, m, range(n + 1, end))):
                content.leave_out(*one, f"{counts}; {EXCLUSION_DOUBT}")
            elif not is_known and not is_count and is_quantity:
                content.leave_out(*one, UNKNOWN_DOUBT)
                content.unknown.append(one)
            else:
                content.unused.append(one)
    for n, row in enumerate(cells.rows):
        if texts_left := [text for m, text in enumerate(row) if text and (n, m) not in cells.used]:
            what = f"row {', '.join(texts_left)}"[:MAX_LISTED_CHARS]
            content.unused.append((what, Path(cells.where(n)).name))


def _count_marks(cells: CellTable, column: int, rows: Sequence[int]) -> str:
    """Return how often a column has each of its texts in the rows that are read; "" if all are alike."""
    marks = Counter(cells.cell(n, column) for n in rows if any((n, m) in cells.used for m in cells.filled(n)))
    texts = [f"{text[:20] or 'blank'} in {count}" for text, count in marks.most_common(MAX_LISTED_MARKS)]
    return ", ".join(texts) if len(marks) > 1 else ""
