"""Find the rows of headers in tables, the columns of each curve below them, and pairs of names and values."""

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from itertools import count

from needlefit.datasets.importing.curves import ATTRIBUTES, ImportContent
from needlefit.datasets.importing.synonyms import Header, find_meaning, load_axes, read_header, split_unit
from needlefit.datasets.importing.tables import CellTable, is_number_like
from needlefit.errors import refusal
from needlefit.geometry.frames import PatientSystem

VECTORS = ("entry point", "pose")  # columns x, y, z that state something of each needle
NO_POINTS = (*VECTORS, "target", "guide", "quaternion")  # columns x, y, z that are no points of a needle
MAX_LABEL_ROWS = 6  # rows above a header in which the names of its columns are looked for
MAX_TITLE_WORDS = 3  # of a title that names a needle
COLUMNS_FIX = "name them with --columns X,Y,Z or --columns needle=NAME,x=NAME,..., by header or number"


@dataclass(frozen=True)
class ColumnGroup:
    """The columns of one curve below a row of headers."""

    row: int  # of the headers; -1: there are none
    headers: Sequence[Header]
    span: Container[int]  # columns that may state something of the curve
    columns: tuple[int, ...] = ()  # of x, y and z; z may be missing
    name: str = ""
    system: PatientSystem | None = None  # which the names of the axes state

    @property
    def is_deflection(self) -> bool:
        """Whether the columns are depth and deflections."""
        return bool(self.columns) and self.headers[self.columns[0]].meaning == "depth"

    def find(self, *meanings: str) -> list[int]:
        """Return the columns with one of some meanings that state something of the curve."""
        named = ((m, one.meaning or one.group) for m, one in enumerate(self.headers))
        return [m for m, one in named if one in meanings and m in self.span and m not in self.columns]


def find_heads(cells: CellTable, content: ImportContent) -> dict[int, list[ColumnGroup]]:
    """Return the curves below each row of headers.

    Row -1: the table has none, and `--columns` numbers its columns.
    """
    heads: dict[int, list[ColumnGroup]] = {}
    for n in range(len(cells.rows)):
        is_units = all(find_meaning("unit", text.strip("[]() ")) for text in cells.rows[n] if text)
        is_point = cells.count_numbers(n) or sum(map(is_number_like, cells.rows[n])) > 1
        if len(cells.filled(n)) > 1 and not is_point and not is_units:
            heads[n] = _read_head(cells, content, n)
    heads = {n: groups for n, groups in heads.items() if groups}
    if not heads and (groups := _read_head(cells, content, -1)):
        heads[-1] = groups
    return heads


def _read_head(cells: CellTable, content: ImportContent, n: int) -> list[ColumnGroup]:
    """Return the curves below a row of headers; none if it names no coordinates, and no depth and deflection.

    A row above may begin the headers, or name curves; the row below may state units.
    """
    width = max(map(len, cells.rows), default=0)
    own = [read_header(cells.cell(n, m).lstrip("#% ") if n >= 0 else "") for m in range(width)]
    own, stated = _name_axes(own)
    rows = range(n - 1, max(n - 1 - MAX_LABEL_ROWS, -1), -1)
    above = next((m for m in rows if not find_pairs(cells, m)), n)
    filled = cells.filled(above) if 0 <= above < n else []
    letters = [own[m].axis for m in filled]
    is_numbers = filled and cells.count_numbers(above) > 1  # names of needles, if above each x
    if len(filled) < 2 or {"y", "z"} & {*letters} or (is_numbers and {*letters} != {"x"}):
        filled = []
    units, headers, label = find_units(cells, n + 1), list[Header](), ""
    for m, one in enumerate(own):
        label = cells.rows[above][m].lstrip("#% ") if m in filled else label if one.axis else ""
        one = one if one.meaning or not label else read_header(f"{label} {one.text}".strip())
        headers.append(replace(one, unit=one.unit or units.get(m, "")))
    headers = apply_columns(headers, content)
    found = _group_axes(cells, headers, n)
    groups, starts = list[ColumnGroup](), sorted(min(axes.values()) for axes in found.values())
    system: PatientSystem | None = "RAS" if stated == "RAS" else "LPS" if stated == "LPS" else None
    for (_, name), axes in found.items():
        columns = tuple(axes[one] for one in "xyz" if one in axes)
        if len({headers[m].unit for m in columns}) > 1:
            raise refusal(f"""the coordinates are {", ".join(headers[m].text for m in columns)}
                expected: one unit
                fix: {COLUMNS_FIX}
                where: {cells.where(max(n, 0), columns[0])}""")
        end = next((m for m in starts if m > min(columns)), width)
        span = {*range(starts[0]), *range(min(columns), end)}  # what stands before the first is of all
        name = name if len(found) > 1 else own[min(columns)].group
        groups.append(group := ColumnGroup(n, headers, span, columns, name, system))
        if len(texts := [headers[m].text for m in group.find("needle")]) > 1:
            raise refusal(f"""{" and ".join(texts)} may name needles
                expected: one column
                fix: state --columns needle=HEADER
                where: {cells.where(max(n, 0))}""")
    if found:
        cells.use(n, *range(width))
        cells.use(n + 1, *units)
        cells.use(above, *(m for m in filled if headers[m].text != own[m].text))
    return groups


def _name_axes(headers: Sequence[Header]) -> tuple[list[Header], str]:
    """Return headers some of which are axes only together, as `r, a, s`, and the system that they state."""
    words = ["".join(split_unit(one.text)[0].casefold().split()) for one in headers]
    for system, usual, names in load_axes():
        if {*names} <= {*words}:
            axes = dict(zip(names, "xyz", strict=False))
            named = [
                Header(one.text, "", axes[word], "", one.unit or usual) if word in axes else one
                for one, word in zip(headers, words, strict=True)
            ]
            return named, system
    return list(headers), ""


def _group_axes(cells: CellTable, headers: Sequence[Header], n: int) -> dict[tuple[int, str], dict[str, int]]:
    """Return the columns of each curve by axis; a letter that comes again begins another curve.

    One column x may be of several curves: `x, y1, y2`. Without axes, depth and deflection are x and y.
    """
    found: dict[tuple[int, str], dict[str, int]] = {}
    for m, one in enumerate(headers):
        if one.axis and one.group not in NO_POINTS:
            turn = next(k for k in count() if one.axis not in found.get((k, one.group), ()))
            found.setdefault((turn, one.group), {})[one.axis] = m
    with_x = [key for key, axes in found.items() if "x" in axes]
    lacking = [axes for axes in found.values() if "x" not in axes]
    if len(with_x) == 1 and lacking and all("y" in axes for axes in lacking):
        for axes in lacking:
            axes["x"] = found[with_x[0]]["x"]
        if len(found[with_x[0]]) == 1:
            del found[with_x[0]]
    depths, tips = (
        [m for m, one in enumerate(headers) if one.meaning == what] for what in ("depth", "deflection")
    )
    if len(depths) == len(tips) == 1 and not found:
        found[0, ""] = {"x": depths[0], "y": tips[0]}
    elif len(depths) == 1 and len(found) == 1 and not with_x:  # deflections along y and z
        (axes,) = found.values()
        axes["x"] = depths[0]
    alone = [headers[m].text for axes in found.values() if len(axes) == 1 for m in axes.values()]
    found = {key: axes for key, axes in found.items() if len(axes) > 1}
    named = [headers[m].text for axes in found.values() for m in axes.values()]
    if twice := [text for text in alone if text in named]:
        raise refusal(f"""two columns are called {twice[0]!r}, and only one of them has a partner
            expected: each once
            fix: {COLUMNS_FIX}
            where: {cells.where(max(n, 0))}""")
    return found


def find_units(cells: CellTable, n: int) -> dict[int, str]:
    """Return the units in a row below a header, by column; none where it holds anything else."""
    if n >= len(cells.rows) or cells.count_numbers(n):
        return {}
    texts = {m: cells.rows[n][m].strip("[]() ") for m in cells.filled(n)}
    units = {m: find_meaning("unit", text) for m, text in texts.items()}
    return {m: unit or texts[m] for m, unit in units.items()} if any(units.values()) else {}


def apply_columns(headers: Sequence[Header], content: ImportContent) -> list[Header]:
    """Return headers with the meanings that `--columns` states, which no other column then has."""
    texts, places = [one.text for one in headers], dict[int, str]()
    for name, meaning in content.columns.items():
        m = texts.index(name) if name in texts else int(name) - 1 if name.isdecimal() else -1
        if 0 <= m < len(texts):
            places[m] = meaning
            content.columns_found.add(name)
    taken = {*places.values(), *("xyz" if "x" in places.values() else "")} - {"unrelated"}
    found = []
    for m, one in enumerate(headers):
        own, unit = places.get(m, ""), one.unit or split_unit(one.text)[1]
        if own:
            one = Header(one.text, *(("", own) if own in "xyz" else (own, "")), unit=unit)
        found.append(Header(one.text) if not own and (one.meaning or one.axis) in taken else one)
    return found


def find_pairs(
    cells: CellTable, n: int, span: Container[int] | None = None
) -> list[tuple[list[int], Header, str]]:
    """Return the pairs of a known name and a value in a row, or in its columns `span`; none of headers.

    `bevel | 1 | depth | 40`, `bevel: 1` in one cell, `diameter | 0.7 | mm`, `boundaries | 20 | 40`, or a
    title such as `Needle 3`.
    """
    filled = [m for m in cells.filled(n) if span is None or m in span]
    texts = {m: cells.rows[n][m].strip("#% ") for m in filled}
    title = texts[filled[0]] if len(filled) == 1 and not re.search("[:=：]", texts[filled[0]]) else ""
    if 1 < len(title.split()) <= MAX_TITLE_WORDS and find_meaning("column", title.split()[0]) == "needle":
        return [(filled, Header(title, "needle"), title)]
    head, *others = texts.values() or ("",)
    what = read_header(head.rstrip(":=： "))
    if what.meaning == "boundaries" and others and all(re.search(r"\d", text) for text in others):
        return [(filled, what, "; ".join(others))]
    if what.meaning in VECTORS and len(others) == 3:
        return [(filled, what, ",".join(others))]
    if len(others) == 2 and what.meaning in ATTRIBUTES and (unit := find_meaning("unit", others[1])):
        return [(filled, replace(what, unit=unit), others[0])]
    split = {m: re.split(r"\s*[:=：]\s*", text, maxsplit=1) for m, text in texts.items()}
    couples = zip(filled[::2], filled[1::2], strict=False)
    pairs = [([a, b], texts[a].rstrip(":=： "), texts[b]) for a, b in couples]
    if all(len(parts) == 2 for parts in split.values()):
        pairs = [([m], parts[0], parts[1]) for m, parts in split.items()]
    values = [read_header(split_unit(value)[0]) for *_, value in pairs]
    if any(one.meaning or one.axis or find_meaning("filler", one.text) for one in values):
        return []
    found = [(places, read_header(name), value) for places, name, value in pairs]
    return [one for one in found if one[1].meaning in ("needle", *ATTRIBUTES)]
