"""Lay a grid of cells out as a table of columns, as a mapping states: headers, rows, and lines of facts."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

from needlefit.datasets.importing.meanings import (
    ATTRIBUTES,
    MEANINGS,
    find_meaning,
    is_side,
    read_header,
    read_quantity,
)
from needlefit.datasets.importing.tables import Table, is_like_number
from needlefit.errors import DataError
from needlefit.project.units import UNITS_MM
from needlefit.schemas.mapping import TableRecord


def lay_out(grid: Table, record: TableRecord) -> Table:
    """Return the columns of a grid as its mapping states them.

    DataError if a row of headers is not there, or a row has more cells than the headers.
    """
    grid = grid.transpose() if record.transposed else grid
    unread = list[str]()
    body = [*_list_body(grid, record, unread)]
    heads = [] if record.layout == "pairs" else _read_heads(grid, record)
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
        unread=unread if (heads or record.layout == "pairs") and not record.transposed else (),
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
REMARKED = {"needle", "unit", *ATTRIBUTES}  #: what a line above a table may state
OF_TEXT = ("needle", "medium", "specimen", "medium|specimen")  #: whose values are any text
OWN_PAIRS = ("needle", "depth", "bevel_side", "medium", "specimen")  #: they end with their block


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


_NUMBERS = re.compile(r"(-?\d(?:[\d.,; ]*\d)?) *([^\W\d]*)")  # `15, 35 mm`
_NEXT_PHRASE = re.compile(r"[,;，；] *(?=[^\W\d_])")  # before a word: numbers behind a comma are of a list


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


def _read_phrase(phrase: str, subject: str) -> tuple[str, str]:
    """Return the name and the value in a phrase of a remark, empty if it states nothing.

    `depth: 40 mm`, `18G`, `bevel up`; `length 150 mm` is that of the `subject`, with which the remark begins.
    """
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
        return (name, value) if is_side(value, "") else ("", "")
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
