"""How rows of a table are laid out: proposed, and laid out as a mapping states it, with lines of facts."""

import re
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby, zip_longest
from pathlib import Path

from needlefit.datasets.importing.meanings import (
    ATTRIBUTES,
    MEANINGS,
    MISSING,
    VALUES,
    Keys,
    find_meaning,
    read_header,
    read_quantity,
    read_side,
)
from needlefit.datasets.importing.tables import (
    Table,
    decode,
    is_like_number,
    parse_number,
    read_text_bytes,
    split_text,
)
from needlefit.errors import DataError
from needlefit.project.units import UNITS_MM
from needlefit.schemas.mapping import TableRecord

MAX_HEADER_ROWS = 6  # largest number of rows of headers
SAMPLE_ROWS = 300  # number of rows by which separator and decimal sign are found
SCORE_OF_NUMBER = 5  # score of a number, or of a known header in each row below it; a cell costs 2
_SEPARATORS = (";", "\t", ",", " ")  # separators in the order in which equally good ones are taken
# patterns, by the decimal sign, of numbers in which another sign parts thousands: what is no other number
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


# ---- as a mapping states it


def lay_out(grid: Table, record: TableRecord) -> Table:
    """Return the columns of a grid as its mapping states them.

    DataError if a row of headers is not there, or a row has more cells than the headers.
    """
    grid = grid.transpose() if record.transposed else grid
    unread = list[str]()
    body = [*_list_body(grid, record, unread)]
    is_of_pairs = record.layout == "pairs"
    heads = [] if is_of_pairs else _read_heads(grid, record)
    headers = [" ".join(filter(None, texts)) for texts in zip_longest(*heads, fillvalue="")]
    width, is_blank = len(headers), record.separator == " "
    if headers and is_blank and body and all(len(cells) == width + 1 for _, cells, _ in body):
        headers, heads = ["", *headers], [["", *head] for head in heads]  # names of rows, as R writes them
    width = len(headers) or max((len(cells) for _, cells, _ in body), default=0)
    names = dict.fromkeys(name for *_, pairs in body for name in pairs)
    rows = list[list[str]]()
    for n, cells, pairs in body:
        is_longer = record.separator == "," and any(cells[width:])
        if heads and (is_longer or (is_blank and len(cells) != width)):
            raise DataError(
                f"has {len(cells)} cells under {width} headers",
                expected="as many as the headers",
                fix="correct separator, decimal or header_rows, or save the file with semicolons or tabs",
                where=grid.place(n),
            )
        blanks = [""] * (width - len(cells))
        rows.append([*cells[:width], *blanks, *(pairs.get(name, "") for name in names)])
    table = replace(
        grid,
        rows=rows,
        lines=[grid.lines[n] if grid.lines else n + 1 for n, *_ in body],
        headers=(*(headers or [""] * width), *names),
        places=[grid.place(n) for n, *_ in body],
        decimal=record.decimal,
        thousands=record.thousands,
        first_headers=tuple(map(tuple, heads)),
        remarked=tuple(names),
        unread=[f"line `{line}`"[:200] for line in unread]
        if (heads or is_of_pairs) and not record.transposed
        else (),
    )
    return table.fill_down(record.fill_down)


def _read_heads(grid: Table, record: TableRecord) -> list[list[str]]:
    """Return the texts of the rows of headers; what stands above several columns is repeated."""
    if max(record.header_rows, default=0) > len(grid.rows):
        raise DataError(
            f"has {len(grid.rows)} rows, and no headers in row {max(record.header_rows)}",
            expected="the numbers of the rows of headers",
            fix="correct header_rows",
            where=grid.path,
        )
    heads = list[list[str]]()
    for number in record.header_rows:
        row = grid.rows[number - 1] or [""]
        first = row[0].removeprefix(record.comment).strip()
        # `# x y z`: the sign is a cell of its own
        heads.append([first, *row[1:]] if first or not is_comment(row, record.comment) else [*row[1:]])
    for head in heads[:-1]:
        if sum(map(bool, head)) < sum(map(bool, heads[-1])):
            for n in range(1, len(head)):
                head[n] = head[n] or head[n - 1]
    return heads


def is_comment(row: Sequence[str], comment: str) -> bool:
    """Whether a row is a line of remarks."""
    return bool(comment and row) and row[0].startswith(comment)


BLOCK = "block"  #: header of the numbers of blocks, where there are several
REMARKED = {"needle", "unit", "pixel", *ATTRIBUTES}  #: meanings that a line above a table may state
OF_TEXT = ("needle", "medium", "specimen", "medium|specimen")  #: meanings whose values are any text
#: meanings of pairs that end with their block
OWN_PAIRS = ("needle", "depth", "bevel_side", "medium", "specimen")


def _list_body(
    grid: Table, record: TableRecord, unread: list[str]
) -> Iterator[tuple[int, Sequence[str], dict[str, str]]]:
    """Yield number and cells of the rows below the headers, and the pairs of names and values above each.

    What all needles share holds until it is stated again. Remarks state what no column does; `unread` gets
    the lines that state nothing. Of a table of pairs the one row has no cells.
    """
    last = max(record.header_rows, default=0)
    heads = [*grid.rows[last - 1]] if 0 < last <= len(grid.rows) else []
    if record.layout == "pairs":
        pairs = dict[str, str]()
        for name, text, unit in ((*row, "", "", "")[:3] for row in grid.rows[last:]):
            if name and text:
                pairs[f"{name} [{unit}]" if unit else name] = text
            elif name and record.separator:  # a line of a text, without a sign between name and value
                stated, rest = read_statements([name], record, ())
                pairs |= stated
                unread += [rest] if rest else []
        yield 0, (), pairs
        return
    repeated = {n for n, row in enumerate(grid.rows) if record.blocks and [*row] == heads}
    ends = {name for key in OWN_PAIRS if key in record.columns for name in record.columns[key].columns}
    stated, is_above, block = dict[str, str](), True, 0
    for n, row in enumerate(grid.rows):
        block += n in repeated
        if n in repeated or n + 1 in (*record.header_rows, *record.skip_rows) or not any(row):
            continue
        filled, is_remark = [text for text in row if text], is_comment(row, record.comment)
        is_full = len(filled) == len(heads) > len(("name", "value"))
        is_pair = record.blocks and not is_full and len(filled) < 4 and not is_like_number(filled[0])
        is_line = is_remark or n < last or is_pair
        pairs, rest = read_statements(filled, record, heads) if is_line else ({}, "")
        if rest:
            unread.append(rest)
        if pairs:
            stated = stated if is_above else {key: text for key, text in stated.items() if key not in ends}
            stated, is_above = stated | pairs, True
        elif not is_line:
            yield n, row, stated | ({BLOCK: str(block)} if len(repeated) > 1 else {})
            is_above = False


_NUMBERS = re.compile(r"(-?\d(?:[\d.,; ]*\d)?) *([^\W\d]*)")  # pattern of several numbers: `15, 35 mm`
# pattern of a sign before a word: numbers behind a comma are of a list
_NEXT_PHRASE = re.compile(r"[,;，；] *(?=[^\W\d_])")


def read_statements(
    cells: Sequence[str], record: TableRecord, head: Sequence[str]
) -> tuple[dict[str, str], str]:
    """Return the values that a line states of the needles of a table, by name; and the rest.

    `depth | 40 | mm`, `boundaries | 20 | 40`, `# depth: 40 mm`, `# needle 18G, length 150 mm, bevel up`.
    What a column of the `head` states is not read. The rest are the phrases that state nothing.
    """
    name, *values = (text.strip(f"{record.comment}# ") for text in cells)
    sign = " " if record.separator in ("", " ", "\t") else f"{record.separator} "
    text = sign.join(filter(None, (name, *values)))
    name = name.rstrip(":=： ")
    if values and not re.search("[:=：]", name) and can_be_stated(name):
        has_unit = len(values) == 2 and not is_like_number(values[1])
        text = f"{name}: {(' ' if has_unit else '; ').join(values)}"
    in_head, stated = {read_header(cell).meaning for cell in head}, dict[str, str]()
    rest, subject, text_name = list[str](), "", ""
    for phrase in _NEXT_PHRASE.split(text):
        name, value = _read_phrase(phrase, subject)
        subject = subject or re.split(r"[\d:=：]", phrase)[0].strip()
        if value and (meaning := read_header(name).meaning) not in in_head:
            stated[name], text_name = value, name if meaning in OF_TEXT else ""
        elif text_name and not re.search("[:=：]", phrase):
            stated[text_name] += f", {phrase}"  # of `medium: gel, with fat`
        else:
            rest.append(phrase)
    return stated, ", ".join(rest)


def can_be_stated(name: str) -> bool:
    """Whether a name is of what lines above a table may state."""
    return not REMARKED.isdisjoint(read_header(name).meaning.split("|"))


# of a remark: `0,085 mm/px`, `1 px = 0.085 mm`
_SCALES = (
    re.compile(r"()([\d.,]+ *[mcu]?m) *(?:/|per|pro|par) *(?:px|pixel)", re.IGNORECASE),
    re.compile(r"(?<![\d.,])1 *(px|pixel) *(?:=|:|≙) *([\d.,]+ *[mcu]?m)", re.IGNORECASE),
)


def _read_phrase(phrase: str, subject: str) -> tuple[str, str]:
    """Return the name and the value in a phrase of a remark, empty if it states nothing.

    `depth: 40 mm`, `18G`, `bevel up`; `length 150 mm` is that of the `subject`, with which the remark begins.
    """
    if scale := next(filter(None, (form.search(phrase) for form in _SCALES)), None):
        return "pixel size", scale[2]
    name, sign, value = (part.strip() for part in re.split("([:=：]|$)", phrase, maxsplit=1))
    if not sign:
        name, value = re.fullmatch(r"(.*?) *(\d.*|\S*)", phrase, re.DOTALL).groups()  # type: ignore[union-attr]
    unit = (read_quantity(value) or (0, ""))[1]
    if unit == "G" and read_header(name).meaning in ("", "needle", "diameter"):
        return name if read_header(name).meaning == "diameter" else "gauge", value
    names = [text for text in (name, f"{subject} {name}") if can_be_stated(text)]
    name = min(names, key=lambda text: "|" in read_header(text).meaning, default="")
    meaning = read_header(name).meaning
    if meaning == "bevel_side":
        return (name, value) if read_side(value, "") is not None else ("", "")
    if meaning == "unit":
        return (name, value) if find_meaning("unit", value) in UNITS_MM else ("", "")
    if not meaning or not (sign or unit in UNITS_MM):
        return "", ""
    has_unit = any(MEANINGS[part].unit for part in meaning.split("|") if part in MEANINGS)
    is_text = not has_unit or meaning == "diameter" or find_meaning("value", value)
    quantity = _NUMBERS.match(value)
    if is_text or quantity is None:
        return (name, value) if is_text else ("", "")
    header = f"{name} [{quantity[2]}]" if find_meaning("unit", quantity[2]) else name
    return header, re.sub("[,;]? +", "; ", quantity[1])
