"""Propose how rows of a table are laid out: encoding, separator, decimal sign, headers, blocks."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from needlefit.datasets.importing.meanings import MEANINGS
from needlefit.datasets.importing.synonyms import UNITS_MM, find_meaning, read_header
from needlefit.datasets.importing.tables import (
    MAX_TABLE_BYTES,
    Grid,
    decode,
    parse_number,
    read_pair,
    split_text,
)
from needlefit.errors import DataError
from needlefit.project.input_files import read_bytes

MISSING = ("nan", "na", "n/a", "-", "--", "null", "none", "missing", "#n/a", "inf", "-inf", "+inf")
MAX_HEADER_ROWS = 6
SAMPLE_ROWS = 300  # rows by which separator and decimal sign are found
_SEPARATORS = (";", "\t", ",", " ")  # in the order in which equally good ones are taken


def sniff_text(path: Path, keys: Mapping[str, str]) -> tuple[Grid, dict[str, Any]]:
    """Return the cells of a text file, and how they are separated; `keys`: what is stated of it."""
    data = read_bytes(path, MAX_TABLE_BYTES)
    encoding = keys.get("encoding", "")
    text = decode(data, path, encoding)
    if not encoding and text.isascii() is False:
        encoding = _find_encoding(data)
        text = decode(data, path, encoding) if encoding else text
    comment = keys.get(
        "comment", next((sign for sign in ("%", "#") if re.search(rf"^{sign}", text, re.M)), "")
    )
    sample = [
        line for line in text.splitlines() if line.strip() and not (comment and line.startswith(comment))
    ]
    sample = sample[: 2 * SAMPLE_ROWS]
    has_tabs = 2 * sum("\t" in line for line in sample) > len(sample)
    choices = [
        (separator, decimal)
        for separator in ([keys["separator"]] if "separator" in keys else _SEPARATORS)
        for decimal in (
            [keys["decimal"]] if "decimal" in keys else (",", ".") if separator in ";\t" else (".", ",")
        )
        if separator != " " or not has_tabs
    ]
    separator, decimal = max(choices, key=lambda choice: _score(sample, path, *choice))
    grid = split_text(text, path, separator)
    thousands = keys.get("thousands", "")
    if not thousands and decimal == "." and separator != ",":
        cells = [cell for row in grid.rows[:SAMPLE_ROWS] for cell in row]
        thousands = "," if any(re.fullmatch(r"-?\d{1,3}(,\d{3})+(\.\d+)?", cell) for cell in cells) else ""
    return grid, {
        "files": [path.name], "separator": separator, "decimal": decimal, "thousands": thousands,
        "encoding": encoding or "utf-8", "comment": comment,
    }  # fmt: skip


def _find_encoding(data: bytes) -> str:
    """Return the encoding of text that is no UTF-8: of two the one in which more headers are known."""
    try:
        data.decode("utf-8-sig")
        return ""
    except UnicodeDecodeError:
        texts = {name: data.decode(name, errors="replace") for name in ("cp1252", "gb18030")}
    return max(texts, key=lambda name: sum(bool(read_header(part.strip()).meaning) for part in
                                           re.split(r"[;,\t\n\r]", texts[name][:500])))  # fmt: skip


def _score(lines: Sequence[str], path: Path, separator: str, decimal: str) -> int:
    """Return how well a separator and a decimal sign explain lines: numbers in rows, less other cells."""
    total = 0
    try:
        # line by line: quotes that are not closed are refused once the separator is known
        rows = [row for line in lines for row in split_text(line, path, separator).rows]
    except DataError:
        return -1
    for row in rows[-SAMPLE_ROWS:]:  # a header may be long, the numbers stand at the end
        cells = [cell for cell in row if cell and cell.lower() not in MISSING]
        numbers = sum(parse_number(cell, decimal) is not None for cell in cells)
        total += 5 * numbers - 2 * len(cells) if numbers > 1 else 0
    heads = [sum(bool(read_header(cell).meaning) for cell in row) for row in rows[:6]]
    return total + max([one for one in heads if one > 1], default=0)


def find_header_rows(grid: Grid, decimal: str, comment: str) -> list[int]:
    """Return the numbers of the rows of headers: the texts right above the first row of numbers."""
    rows = grid.rows
    numeric = [
        n
        for n, row in enumerate(rows)
        if sum(parse_number(cell, decimal) is not None for cell in row) > (1 if len(row) > 2 else 0)
        and not _is_head(row, comment)
    ]
    first = next((n for n in numeric if n + 1 in numeric or n + 1 >= len(rows) or not any(rows[n + 1])), None)
    if first is None:
        known = [n for n, row in enumerate(rows) if sum(map(bool, row)) > 1 and _is_head(row, comment)]
        return [known[0] + 1] if known else []
    found = list[int]()
    for n in range(first - 1, max(first - 1 - MAX_HEADER_ROWS, -1), -1):
        row = rows[n]
        filled = [cell for cell in row if cell]
        if not filled or (row[0].startswith(comment) and comment and found):
            break
        if found and (
            len(filled) < 2 or (read_pair(row) is not None and not _is_label(row, rows[found[0] - 1]))
        ):
            break
        if (len(filled) < 2 or n in numeric) and not (found and _names_groups(row, rows[found[0] - 1])):
            break
        found.insert(0, n + 1)
    return found


def _names_groups(row: Sequence[str], below: Sequence[str]) -> bool:
    """Whether each text, a number too, stands above a column x, of which there are as many."""
    above = [n for n, cell in enumerate(row) if cell]
    return above == [n for n, cell in enumerate(below) if read_header(cell).axis == "x"]


def _is_label(row: Sequence[str], below: Sequence[str]) -> bool:
    """Whether a row names groups of the columns below it: it has several texts, and none states a value."""
    filled = [cell for cell in row if cell]
    is_pair = read_header(filled[0].rstrip(":= ")).meaning in MEANINGS and len(filled) < sum(map(bool, below))
    return len(filled) > 1 and not is_pair and sum(map(bool, below)) > 2


def _is_head(row: Sequence[str], comment: str) -> bool:
    """Whether texts of a row are known headers, more than numbers."""
    known = [read_header(cell.lstrip(f"{comment} ")) for cell in row if cell]
    return sum(bool(one.meaning or one.axis) for one in known) > len(known) / 2


def has_blocks(grid: Grid, numbers: Sequence[int], comment: str) -> bool:
    """Whether headers come again, or pairs that are known stand above them."""
    if not numbers:
        return False
    head = [*grid.rows[numbers[-1] - 1]]
    again = any([*row] == head for row in grid.rows[numbers[-1] :])
    pairs = [read_pair(row) for row in grid.rows[: numbers[0] - 1] if any(row)]
    known = [read_header(pair[0]).meaning in MEANINGS for pair in pairs if pair is not None]
    titled = [pair for pair in pairs if pair and find_meaning("column", pair[1].split(" ")[0]) == "needle"]
    return again or any(known) or bool(titled)


def count_decimals(grid: Grid, decimal: str) -> int:
    return sum(
        parse_number(cell, decimal) is not None and not cell.isdecimal() for row in grid.rows for cell in row
    )


def find_stated_unit(grid: Grid, comment: str) -> str:
    """Return the unit of lengths that a line of remarks states, as `% Length unit: m`."""
    remarks = [
        read_pair([" ".join(row).lstrip(comment)]) for row in grid.rows if comment and _starts(row, comment)
    ]
    units = [
        find_meaning("unit", pair[1]) for pair in remarks if pair and pair[0].casefold().endswith("unit")
    ]
    return next((unit for unit in units if unit in UNITS_MM), "")


def _starts(row: Sequence[str], comment: str) -> bool:
    return bool(row) and row[0].startswith(comment)
