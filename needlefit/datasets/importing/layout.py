"""Propose how rows of a table are laid out: encoding, separator, decimal sign, headers, blocks."""

import re
import statistics
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from needlefit.datasets.importing.meanings import MISSING, VALUES, Keys, read_header
from needlefit.datasets.importing.tables import Table, decode, parse_number, read_text_bytes, split_text
from needlefit.errors import DataError

MAX_HEADER_ROWS = 6  # largest number of rows of headers
SAMPLE_ROWS = 300  # number of rows by which separator and decimal sign are found
SCORE_OF_NUMBER = 5  # of a number, or of a known header in each row below it; a cell costs 2
_SEPARATORS = (";", "\t", ",", " ")  # in the order in which equally good ones are taken
# Numbers in which a sign parts thousands, by their decimal sign: what is no other number.
_GROUPED = {
    ".": re.compile(r"-?\d{1,3}((,\d{3})+\.\d+|(,\d{3}){2,})"),
    ",": re.compile(r"-?\d{1,3}((\.\d{3})+,\d+|(\.\d{3}){2,})"),
}

Rows = Sequence[Sequence[str]]


def sniff_text(path: Path, given: Keys) -> tuple[Table, Keys]:
    """Return the cells of a text file, and how they are separated; `given`: what is stated of it."""
    data = read_text_bytes(path)
    encoding = given.get("encoding") or _find_encoding(data)
    text = decode(data, path, encoding)
    first = next((sign for sign in "%#" if re.search(rf"^{sign}", text, re.M)), "")
    comment = given.get("comment", first)
    lines = [
        line for line in text.splitlines() if line.strip() and not (comment and line.startswith(comment))
    ]
    sample = lines[: 2 * SAMPLE_ROWS]
    has_tabs = 2 * sum("\t" in line for line in sample) > len(sample)
    if "separator" not in given and (sign := _find_pair_sign(lines)):
        given = {**given, "separator": sign}
    choices = [
        (separator, decimal)
        for separator in ([given["separator"]] if "separator" in given else _SEPARATORS)
        for decimal in ([given["decimal"]] if "decimal" in given else ",." if separator in ";\t" else ".,")
        if separator != " " or not has_tabs
    ]
    separator, decimal = max(choices, key=lambda choice: _score(sample, path, *choice))
    return split_text(text, path, separator), {
        "files": [path.name],
        "separator": separator,
        "decimal": decimal,
        "encoding": encoding,
        "comment": comment,
    }


def _find_pair_sign(lines: Sequence[str]) -> str:
    """Return the sign that most lines have between the name and the value of a fact; empty if they do not."""
    for sign in ":=;\t,":
        pairs = [line.split(sign) for line in lines if line.count(sign) in (1, 2)]
        names = [read_header(name).meaning for name, *_ in pairs]
        if 2 * len(pairs) > len(lines) and sum(name in VALUES for name in names) > 1:
            return sign
    return ""


def _find_encoding(data: bytes) -> str:
    """Return UTF-8, if text is that; else of two encodings the one in which more headers are known."""
    try:
        data.decode("utf-8")
        return "utf-8"
    except UnicodeDecodeError:
        texts = {name: data.decode(name, errors="replace")[:500] for name in ("cp1252", "gb18030")}
    parts = {name: re.split(r"[;,\t\n\r]", text) for name, text in texts.items()}
    return max(parts, key=lambda name: sum(bool(read_header(part.strip()).meaning) for part in parts[name]))


def _score(lines: Sequence[str], path: Path, separator: str, decimal: str) -> int:
    """Return how well a separator and a decimal sign explain lines.

    It counts numbers in rows, less other cells, and known headers above rows of as many cells.
    """
    try:
        # line by line: quotes that are not closed are refused once the separator is known
        rows = [row for line in lines for row in split_text(line, path, separator).rows]
    except DataError:
        return -1
    width = statistics.mode(map(len, rows)) if rows else 0
    heads = [sum(bool(read_header(cell).meaning) for cell in row) for row in rows[:6] if len(row) == width]
    count = max(heads, default=0)
    return _score_numbers(rows, decimal) + (SCORE_OF_NUMBER * count * len(rows) if count > 1 else 0)


def _score_numbers(rows: Rows, decimal: str) -> int:
    total = 0
    for row in rows[-SAMPLE_ROWS:]:  # a header may be long, the numbers stand at the end
        cells = [cell for cell in row if cell and cell.lower() not in MISSING]
        numbers = sum(_is_number(cell, decimal) for cell in cells)
        total += SCORE_OF_NUMBER * numbers - 2 * len(cells) if numbers > 1 else 0
    return total


def _is_number(cell: str, decimal: str) -> bool:
    return parse_number(cell, decimal) is not None or _GROUPED[decimal].fullmatch(cell) is not None


# ---- rows


def propose_layout(grid: Table, stated: Keys) -> Keys:
    """Return keys of a table with those of its rows."""
    keys = dict(stated)
    if "decimal" not in keys:  # texts in a sheet
        keys["decimal"] = max(".,", key=lambda sign: _score_numbers(grid.rows, sign))
    decimal, comment = keys["decimal"], keys.get("comment", "")
    cells = {cell for row in grid.rows[:SAMPLE_ROWS] for cell in row}
    if "thousands" not in keys and any(map(_GROUPED[decimal].fullmatch, cells)):
        keys["thousands"] = "," if decimal == "." else "."
    if keys.setdefault("transposed", _is_transposed(grid.rows, decimal)):
        grid = grid.transpose()
    if "header_rows" not in keys:
        keys["header_rows"] = _find_header_rows(grid.rows, decimal, comment)
    head, *below = grid.rows[max(keys["header_rows"], default=1) - 1 :]
    keys.setdefault("blocks", any([*row] == [*head] for row in below) and bool(keys["header_rows"]))
    return keys


def _is_transposed(rows: Rows, decimal: str) -> bool:
    """Whether axes stand in the first column, each before its numbers."""
    axes = [
        read_header(row[0]).axis
        for row in rows
        if sum(_is_number(cell, decimal) for cell in row[1:]) == sum(map(bool, row[1:])) > 3
    ]
    return {"x", "y"} <= {*axes}


def _find_header_rows(rows: Rows, decimal: str, comment: str) -> list[int]:
    """Return the numbers of the rows of headers: the texts right above the first long run of numbers."""
    numeric = [
        sum(_is_number(cell, decimal) or cell.lower() in MISSING for cell in row) > (len(row) > 2)
        and not _is_head(row, comment)
        for row in rows
    ]
    runs = [
        [n for n, _ in run] for is_run, run in groupby(enumerate(numeric), lambda pair: pair[1]) if is_run
    ]
    longest = max(map(len, runs), default=0)
    if not runs:
        heads = [n for n, row in enumerate(rows) if sum(map(bool, row)) > 1 and _is_head(row, comment)]
        return [heads[0] + 1] if heads else []
    first = next(run[0] for run in runs if 2 * len(run) >= longest)
    numbers = list[int]()
    for n in range(first - 1, max(first - 1 - MAX_HEADER_ROWS, -1), -1):
        row, below = rows[n], rows[numbers[0] - 1] if numbers else ()
        filled = [cell for cell in row if cell]
        if not filled or (row[0].startswith(comment) and comment and numbers):
            break
        if len(filled) < 2 or (numbers and _is_line(row, below)):
            break
        if numeric[n] and not (numbers and _names_groups(row, below)):
            break
        numbers.insert(0, n + 1)
    return numbers


def _names_groups(row: Sequence[str], below: Sequence[str]) -> bool:
    """Whether each text, a number too, stands above a column x, of which there are as many."""
    above = [n for n, cell in enumerate(row) if cell]
    return above == [n for n, cell in enumerate(below) if read_header(cell).axis == "x"]


def _is_line(row: Sequence[str], below: Sequence[str]) -> bool:
    """Whether a row is a line of text or a pair above headers: it ends before them, and none comes again."""
    filled, heads = [cell for cell in row if cell], [cell for cell in below if cell]
    is_short = [*row[: len(filled)]] == filled and len(filled) < len(heads) == len({*heads})
    return len(heads) < 3 or is_short


def _is_head(row: Sequence[str], comment: str) -> bool:
    """Whether texts of a row are known headers, more than numbers."""
    are_known = [read_header(cell.lstrip(f"{comment} ")).is_known for cell in row if cell]
    return sum(are_known) > len(are_known) / 2
