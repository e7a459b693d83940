"""Propose a mapping of files that nobody has described: what is sure, what is assumed, and what is open.

It is the only place that guesses, and it reads no needle: a person sees what it proposes, and `read` goes by
that.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import count, pairwise
from pathlib import Path
from typing import Any

from needlefit.datasets.importing.examples import EXAMPLE_SHEET
from needlefit.datasets.importing.layout import (
    MISSING,
    count_decimals,
    find_header_rows,
    find_stated_unit,
    has_blocks,
    sniff_text,
)
from needlefit.datasets.importing.meanings import ATTRIBUTES, MEANINGS, ROWS, SENSOR, VALUES, VECTORS
from needlefit.datasets.importing.read import MAX_CURVES
from needlefit.datasets.importing.stated import name_set
from needlefit.datasets.importing.synonyms import (
    INDEX,
    Header,
    find_meaning,
    load_axes,
    read_header,
    split_unit,
)
from needlefit.datasets.importing.tables import (
    BLOCK,
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    Grid,
    Table,
    lay_out,
    read_sheets,
    read_structured,
)
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS
from needlefit.datasets.tip_tracks import MIN_READINGS
from needlefit.errors import ConfigError, refusal
from needlefit.geometry.surfaces import READ_SUFFIXES
from needlefit.project.input_files import is_dir, is_file, path_exists
from needlefit.project.toml import check, override
from needlefit.schemas.mapping import MappingRecord, TableRecord

SETUP_SHEET, GUIDE_SHEET = "setup", "read me"  # of the workbook to fill in
CODES = ("-999", "-999.0", "-9999", "-9999.0", "-99", "999", "9999")  # numbers that stand for no measurement
NO_POINTS = (*VECTORS, "target", "guide", "quaternion")  # columns x, y, z that are no points of a needle
COORDINATES = ("x", "y", "z", "depth", "deflection", "deflection_z", "guide")
TABLE_KEYS = tuple(key for key in TableRecord.model_fields if key not in ("files", "columns"))
_QUANTITY = re.compile(r"\D{0,3}[-+]?\d+([.,]\d+)?\s*\S{0,4}")  # a number with a unit: 22G, 0,7 mm
MIN_NEEDLE_GPA = 1.0  # GPa, below which a modulus may be that of the tissue


@dataclass(frozen=True)
class Open:
    """A question that only a person can answer: each answer states keys of the mapping."""

    key: str  # that the answer states
    question: str
    choices: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # by answer; none: any value
    where: str = ""

    def describe_fix(self) -> str:
        """Return the options that state the answers."""
        if not self.choices:
            return f"state {name_set(self.key)}"
        options = [
            " ".join(name_set(key, value) for key, value in stated.items())
            for stated in self.choices.values()
        ]
        return f"state {', or '.join(options)}"


@dataclass
class Draft:
    """A mapping that is proposed, and what of it is assumed, open, or not used."""

    tables: list[dict[str, Any]] = field(default_factory=list)  # keys of `TableRecord`
    laid: list[Table] = field(default_factory=list)  # the table by which each was proposed
    surfaces: list[str] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)
    opens: list[Open] = field(default_factory=list)
    unused: list[tuple[str, str]] = field(default_factory=list)  # what, and where it stands
    origin: str = "measured"

    def ask(self, key: str, question: str, choices: Mapping[str, Mapping[str, str]], where: str) -> None:
        """Add a question that only a person can answer."""
        self.opens.append(Open(key, question, choices, where))

    def to_record(self, where: str) -> MappingRecord:
        """Return the mapping, checked."""
        tables = {
            "schema": MappingRecord.SCHEMA,
            "origin": self.origin,
            "surfaces": self.surfaces,
            "values": self.values,
            "assumed": self.assumed,
            "tables": self.tables,
        }
        return check(tables, MappingRecord, where)


class Stated:
    """What a person states of the mapping: `KEY=VALUE`, by the keys of `needlefit explain mapping`."""

    def __init__(self, assignments: Sequence[tuple[str, str]] = ()) -> None:
        self.values = {key: text for key, text in assignments if key in VALUES}
        self.columns = dict[str, dict[str, str]]()  # by meaning and part
        self.table = dict[str, str]()  # keys of every table
        self.single = list[tuple[str, str]]()  # `tables.2.sheet`
        self.unit = self.origin = ""
        for key, text in assignments:
            head, _, part = key.partition(".")
            if key in VALUES:
                continue
            if key in ("unit", "origin"):
                setattr(self, key, text)
            elif head == "tables":
                self.single.append((key, text))
            elif head in TABLE_KEYS:
                self.table[key] = text
            elif head in MEANINGS and part:
                self.columns.setdefault(head, {})[part] = text
            elif head in MEANINGS:
                self.columns.setdefault(head, {})["column"] = text
            else:
                raise ConfigError.of(f"""--set {key}={text[:40]}: there is no key `{key}`
                    expected: unit, origin, {", ".join(TABLE_KEYS)}, {", ".join(VALUES)}, or MEANING.column of
                        {", ".join(MEANINGS)}
                    fix: correct the key""")

    def has_column(self, meaning: str) -> bool:
        """Whether a column of a meaning is stated."""
        return "column" in self.columns.get(meaning, {})


def draft_mapping(paths: Sequence[Path], stated: Stated) -> tuple[Draft, list[Path]]:
    """Return the proposed mapping of files and of the readable files of folders, and these files.

    DataError of a file that cannot be read, or holds a dataset already.
    """
    draft = Draft(values=dict(stated.values), origin=stated.origin or "measured")
    files = [*_list_files(paths, draft)]
    if len(files) > MAX_CURVES:
        raise refusal(f"""{len(files)} files are named
            expected: at most {MAX_CURVES}
            fix: name the folder of the needles""")
    for path in files:
        suffix = path.suffix.lower()
        if suffix in READ_SUFFIXES:
            draft.surfaces.append(path.name)
        elif suffix in TEXT_SUFFIXES:
            _draft_grid(sniff_text(path, stated.table), draft, stated)
        elif suffix in SHEET_SUFFIXES:
            _draft_workbook(path, draft, stated)
        else:
            table, remarks = read_structured(path)
            draft.unused += [(remark, path.name) for remark in remarks]
            _draft_table(table, {"files": [path.name], "holds": "facts"}, draft, stated)
    _merge_alike(draft)
    for key, text in stated.single:
        (draft.tables,) = override({"tables": draft.tables}, [(key, text)], "--set").values()
    return draft, files


def _list_files(paths: Iterable[Path], draft: Draft) -> Iterator[Path]:
    """Yield the files that are named, or stand in a folder that is."""
    from needlefit.datasets.formats import FORMATS

    known = (
        *TEXT_SUFFIXES,
        *SHEET_SUFFIXES,
        *READ_SUFFIXES,
        *(end for one in FORMATS.values() for end in one.suffixes),
    )
    for path in paths:
        if is_file(own := path if path.name == "dataset.toml" else path / "dataset.toml"):
            raise refusal(f"""is a dataset already
                expected: files of other programs
                fix: use it as it is: needlefit check {own}
                where: {path}""")
        if not is_dir(path):
            if not path_exists(path):
                raise refusal(f"""there is no such file
                    fix: check the name and the path
                    where: {path}""")
            yield path
            continue
        for one in sorted(path.iterdir()):
            if one.is_dir():
                draft.unused.append((f"folder {one.name}", "it is not searched: name it"))
            elif not one.name.lower().endswith(known) or one.name.startswith((".", "~$")):
                draft.unused.append((f"file {one.name}", "its name"))
            else:
                yield one


def _merge_alike(draft: Draft) -> None:
    """Make one entry of files that are read alike."""
    merged, laid = list[dict[str, Any]](), list[Table]()
    for table, own in zip(draft.tables, draft.laid, strict=True):
        same = next((one for one in merged if {**one, "files": 0} == {**table, "files": 0}), None)
        if same is not None and own.path.name not in same["files"]:
            same["files"] = [*same["files"], *table["files"]]
        else:
            merged.append(table)
            laid.append(own)
    draft.tables, draft.laid = merged, laid


# ---- sheets and grids


def _draft_workbook(path: Path, draft: Draft, stated: Stated) -> None:
    """Propose the sheets of a workbook; those that begin with `example` where no other one is filled in."""
    sheets = [one for one in read_sheets(path) if one.sheet.lower() != GUIDE_SHEET]
    own = [one for one in sheets if not one.sheet.lower().startswith(EXAMPLE_SHEET)]
    filled = [one for one in own if one.sheet.lower() != SETUP_SHEET and sum(map(any, one.rows)) > 1]
    chosen = (
        sheets if len(own) == len(sheets) else own if filled else [one for one in sheets if one not in own]
    )
    for grid in sheets:
        if grid not in chosen:
            draft.unused.append((f"sheet {grid.sheet}", path.name))
            continue
        keys = {"files": [path.name], "sheet": grid.sheet}
        if grid.sheet.lower().removeprefix(EXAMPLE_SHEET).strip() == SETUP_SHEET:
            keys |= {"layout": "pairs", "holds": "facts", "of": "all"}
            _draft_values(grid, keys, draft, stated)
        else:
            _draft_grid((grid, keys), draft, stated)


def _draft_values(grid: Grid, keys: dict[str, Any], draft: Draft, stated: Stated) -> None:
    """Propose what a sheet of names and values states of all."""
    table = lay_out(grid, check(keys, TableRecord, grid.path))
    columns = dict[str, dict[str, Any]]()
    heads, cells = (*table.first_headers, ())[0], (*table.rows, ())[0]
    for name, text in zip(heads, cells, strict=True):
        plain, unit = split_unit(name)
        key = "_".join(plain.lower().replace("_", " ").split())
        key = key if key in VALUES or key == "origin" else find_meaning("column", plain)
        if key == "origin":
            draft.origin = stated.origin or text
        elif key in stated.values:
            continue
        elif key in ("title", "source", "license", "entry", "bevel", "guide"):
            draft.values[key] = text
        elif key in VALUES:
            header = next(one for one in table.headers if one == name or one.startswith(f"{name} ["))
            unit = find_meaning("unit", unit or split_unit(header)[1]) or split_unit(header)[1]
            columns[key] = {"column": header} | ({"unit": unit} if unit else {})
        else:
            draft.unused.append((f"row {name} = {text}", f"{grid.path.name}, sheet {grid.sheet}"))
    if columns:
        draft.tables.append(keys | {"columns": columns})
        draft.laid.append(table)


def _draft_grid(sniffed: tuple[Grid, dict[str, Any]], draft: Draft, stated: Stated) -> None:
    grid, keys = sniffed
    decimal, comment = keys.get("decimal", "."), keys.get("comment", "")
    if grid.sheet and not count_decimals(grid, ".") and count_decimals(grid, ","):
        keys["decimal"] = decimal = ","  # texts in a sheet
    given = override({}, [(key, text) for key, text in stated.table.items() if "." not in key], "--set")
    numbers = given["header_rows"] if "header_rows" in given else find_header_rows(grid, decimal, comment)
    keys |= {"header_rows": numbers, "blocks": has_blocks(grid, numbers, comment)} | given
    keys.setdefault("holds", "facts")
    if not any(map(any, grid.rows)):
        draft.unused.append((f"sheet {grid.sheet}" if grid.sheet else f"file {grid.path.name}", "empty"))
        return
    table = lay_out(grid, check(keys, TableRecord, grid.path))
    if not keys["blocks"] and numbers:
        above = [row for row in grid.rows[: numbers[0] - 1] if any(row)]
        for row in above:
            draft.unused.append((f"row {', '.join(filter(None, row))}"[:200], grid.path.name))
    _draft_table(table, keys, draft, stated, find_stated_unit(grid, comment))


# ---- columns


def _draft_table(table: Table, keys: dict[str, Any], draft: Draft, stated: Stated, unit: str = "") -> None:
    """Propose what the columns of a table mean; `unit` is that of lengths whose header states none."""
    stated = copy(stated)
    stated.unit = stated.unit or unit
    headers = [_read_column(table, n) for n in range(len(table.headers))]
    headers, signs = _name_axes(headers)
    filled = [any(row[n] for row in table.rows) for n in range(len(headers))]
    columns = dict[str, dict[str, Any]]()
    taken = set[int]()
    for meaning, parts in stated.columns.items():  # what is stated comes first
        names = [part.strip() for part in parts.get("column", "").split("|")] if "column" in parts else []
        found = [
            table.find(int(name) if name.isdecimal() and table.find(name) is None else name) for name in names
        ]
        if names and None not in found:
            taken |= {n for n in found if n is not None}
            columns[meaning] = _spell(table, meaning, [n for n in found if n is not None], headers) | {
                key: value for key, value in parts.items() if key != "column"
            }
    blocked = {*columns} | ({"x", "y", "z"} if columns.keys() & {"deflection"} else set())
    blocked |= {"deflection", "deflection_z"} if columns.keys() & {"y"} else set()
    groups = {} if blocked & {"x", "y"} and "y" in columns else _group_axes(headers, taken, blocked)
    if "deflection" in columns:
        groups = {}
    where = table.path.name + (f", sheet {table.name}" if "sheet" in keys else "")
    meant = dict[str, list[int]]()
    for n, header in enumerate(headers):
        if n not in taken and filled[n] and header.meaning in MEANINGS and header.meaning not in blocked:
            meant.setdefault(header.meaning, []).append(n)
    for meaning in (*VECTORS, "guide"):  # columns x, y and z of a place
        own = [n for n, one in enumerate(headers) if one.group == meaning and one.axis and n not in taken]
        if own and meaning not in columns and "y" in {headers[n].axis for n in own}:
            meant[meaning] = own
    if "guide" in meant:
        columns_of_guide = ", ".join(str(_spell_name(table, n)) for n in meant["guide"])
        draft.assumed["guide"] = f"{columns_of_guide}: taken to be the guide; guide=none if it is not"
    if "needle" in meant:
        meant["needle"] = _choose_names(table, meant["needle"], columns, draft, where)
    _ask_ambiguous(table, meant, headers, columns, keys, draft, where)
    for meaning, own in meant.items():
        if own and meaning not in columns:
            several = meaning in (*VECTORS, "boundaries", "guide", "needle")
            columns[meaning] = _spell(table, meaning, own if several else own[:1], headers)
            taken |= {*(own if several else own[:1])}
    if "needle" not in columns and keys.get("blocks") and (block := table.find(BLOCK)) is not None:
        columns["needle"] = {"column": BLOCK}
        taken.add(block)
    if columns.keys() & {*SENSOR[1:3]} and "curvature_sd" not in columns and "point_sd" in columns:
        columns["curvature_sd"] = columns.pop("point_sd")
        unit = headers[table.find(columns["curvature_sd"]["column"]) or 0].unit
        columns["curvature_sd"]["unit"] = unit if unit.startswith("1/") or not unit else f"1/{unit}"
    _draft_kind(table, headers, groups, columns, taken, signs, keys, draft, stated, where)


def _read_column(table: Table, n: int) -> Header:
    """Return what the texts above a column mean: all together, else one of them."""
    texts = dict.fromkeys((table.headers[n], *(head[n] for head in table.first_headers if n < len(head))))
    known = [read_header(text) for text in texts if text]
    best = next((one for one in known if one.meaning or one.axis), Header(table.headers[n]))
    unit = best.unit or next((one.unit for one in known if one.unit), "")
    return Header(table.headers[n], best.meaning, best.axis, best.group, unit)


def _name_axes(headers: Sequence[Header]) -> tuple[list[Header], dict[str, int]]:
    """Return headers some of which are axes only together, as `r, a, s`; and the signs of axes in LPS."""
    words = ["".join(split_unit(one.text)[0].casefold().split()) for one in headers]
    for system, usual, names in load_axes():
        if {*names} <= {*words}:
            axes = dict(zip(names, "xyz", strict=False))
            named = [
                Header(one.text, "", axes[word], "", one.unit or usual) if word in axes else one
                for one, word in zip(headers, words, strict=True)
            ]
            return named, {"x": -1, "y": -1} if system == "RAS" else {}
    return [*headers], {}


def _group_axes(
    headers: Sequence[Header], taken: set[int], blocked: set[str]
) -> dict[tuple[int, str], dict[str, int]]:
    """Return the columns of each needle by axis; a letter that comes again begins another needle.

    One column x may be of several needles: `x, y1, y2`.
    """
    groups: dict[tuple[int, str], dict[str, int]] = {}
    for n, one in enumerate(headers):
        if one.axis and one.group not in NO_POINTS and n not in taken and one.axis not in blocked:
            turn = next(k for k in count() if one.axis not in groups.get((k, one.group), ()))
            groups.setdefault((turn, one.group), {})[one.axis] = n
    with_x = [key for key, axes in groups.items() if "x" in axes]
    lacking = [axes for axes in groups.values() if "x" not in axes]
    if len(with_x) == 1 and lacking and all("y" in axes for axes in lacking):
        for axes in lacking:
            axes["x"] = groups[with_x[0]]["x"]
        if len(groups[with_x[0]]) == 1:
            del groups[with_x[0]]
    return {key: axes for key, axes in groups.items() if "y" in axes}


def _spell(table: Table, meaning: str, columns: Sequence[int], headers: Sequence[Header]) -> dict[str, Any]:
    """Return how a mapping names columns, and the unit of the first."""
    names = [_spell_name(table, n) for n in columns]
    unit = headers[columns[0]].unit
    unit = f"1/{unit}" if meaning.startswith("curvature") and unit and not unit.startswith("1/") else unit
    return {"column": names[0] if len(names) == 1 else names} | ({"unit": unit} if unit else {})


def _spell_name(table: Table, n: int) -> str | int:
    for text in (*(head[n] for head in table.first_headers[:1] if n < len(head)), table.headers[n]):
        if text and table.find(text) == n:
            return text
    return n + 1


def _choose_names(
    table: Table, own: list[int], columns: dict[str, Any], draft: Draft, where: str
) -> list[int]:
    """Return the column that names needles: of several the first in which names come again."""
    repeated = [
        n
        for n in own
        if len({row[n] for row in table.rows if row[n]}) < sum(bool(row[n]) for row in table.rows)
    ]
    chosen = (repeated or own)[:1]
    for n in own:
        if n not in chosen:
            draft.unused.append((f"column {table.headers[n]}", where))
    return chosen


def _ask_ambiguous(
    table: Table,
    meant: dict[str, list[int]],
    headers: Sequence[Header],
    columns: dict[str, Any],
    keys: dict[str, Any],
    draft: Draft,
    where: str,
) -> None:
    """Ask what words mean that labs use in two ways."""

    def drop(meaning: str) -> str:
        own = meant.pop(meaning)
        keys["unused"] = [*keys.get("unused", []), *(_spell_name(table, n) for n in own)]
        return str(_spell_name(table, own[0]))

    angle = [
        n
        for n, one in enumerate(headers)
        if one.meaning == "bevel_angle" and any(row[n] for row in table.rows)
    ]
    if (
        angle
        and "bevel_side" not in meant
        and "bevel_side" not in columns
        and "bevel_side" not in draft.values
    ):
        name = str(_spell_name(table, angle[0]))
        draft.ask(
            "bevel_side",
            f"What `{name}` is: the roll of the bevel about the needle, or the angle of its cut",
            {"roll": {"bevel_side.column": name, "bevel_side.unit": "deg"}, "cut": {"bevel_side": "1"}},
            where,
        )
    counts = [
        n for n, text in enumerate(table.headers) if text.strip().casefold() in ("n", "count", "trials")
    ]
    if "point_sd" in meant and counts and any("mean" in text.casefold() for text in table.headers):
        name, unit = (
            drop("point_sd"),
            headers[meant.get("point_sd", [0])[0]].unit if "point_sd" in meant else "mm",
        )
        count = str(_spell_name(table, counts[0]))
        draft.ask(
            "point_sd",
            f"Of what `{name}` is the standard deviation: one trial (then divided by the root of "
            f"`{count}`), or the mean",
            {
                "trial": {"point_sd.column": name, "point_sd.divide_by_root": count},
                "mean": {"point_sd.column": name},
            },
            where,
        )
    modulus = meant.get("modulus", [])
    if modulus and "modulus" in draft.values:
        drop("modulus")
    elif modulus:
        unit = headers[modulus[0]].unit or "GPa"
        factor = {"GPa": 1.0, "MPa": 1e-3, "kPa": 1e-6, "Pa": 1e-9}.get(unit, 1.0)
        values = [table.number(row[modulus[0]]) for row in table.rows if row[modulus[0]]]
        if any(value is not None and value * factor < MIN_NEEDLE_GPA for value in values):
            name = drop("modulus")
            draft.ask(
                "modulus",
                f"Whose Young's modulus `{name}` is: of the needle, or of the tissue (not used)",
                {
                    "needle": {"modulus.column": name, "modulus.unit": unit},
                    "tissue": {"modulus": "steel"},
                },
                where,
            )
    medium = meant.get("medium", [])
    for n in medium:
        is_phantom = "phantom" in table.headers[n].casefold()
        if is_phantom and "specimen" not in meant and len({row[n] for row in table.rows if row[n]}) > 1:
            name = drop("medium")
            draft.ask(
                "medium",
                f"What differs between values of `{name}`: the gel (medium), or the block (specimen)",
                {"medium": {"medium.column": name}, "specimen": {"specimen.column": name}},
                where,
            )


def _draft_kind(
    table: Table,
    headers: Sequence[Header],
    groups: Mapping[tuple[int, str], Mapping[str, int]],
    columns: dict[str, Any],
    taken: set[int],
    signs: Mapping[str, int],
    keys: dict[str, Any],
    draft: Draft,
    stated: Stated,
    where: str,
) -> None:
    """Propose what the rows of a table are, and add its entries to the draft."""
    holds = stated.table.get("holds", "")
    if (groups or columns.keys() & {"y", "deflection"}) and "fill_down" not in stated.table:
        table = _fill_down(table, columns.get("needle", {}).get("column", ""), keys, draft)
    entries = list[dict[str, Any]]()
    for (_, name), axes in groups.items():
        own = {axis: _spell(table, axis, [n], headers) for axis, n in axes.items()}
        own = {axis: one | ({"sign": signs[axis]} if axis in signs else {}) for axis, one in own.items()}
        if "needle" not in columns and len(groups) > 1:
            own["needle"] = {"value": name.strip() or f"{len(entries) + 1}"}
        entries.append(own)
        taken |= {*axes.values()}
    if entries and "deflection" in columns and "depth" in columns and "deflection" not in stated.columns:
        names = [columns["deflection"]["column"], *(one["y"]["column"] for one in entries)]
        question = f"Which column is the deflection of the tip: {' or '.join(f'`{name}`' for name in names)}"
        choices = {str(name): {"deflection.column": str(name)} for name in names}
        draft.ask("deflection.column", question, choices, where)
    if entries and "depth" in columns and all("x" not in one for one in entries):
        names = _list_names(table, columns)
        is_single = bool(names) and len({*names}) == len(names)
        holds = holds or ("tips" if is_single else "tracks")
    elif "deflection" in columns and "depth" in columns:
        entries = [{}]
        holds = holds or ("tracks" if _are_tracks(table, columns) else "tips")
    elif columns.keys() & {"x", "y"} == {"x", "y"}:
        entries = [{}]
    elif columns.keys() & {*SENSOR[1:3]} and "needle" in columns:
        entries, holds = [{}], "curvatures"
        place = "sensor_from_base" if "sensor_from_base" in columns else "sensor"
        for key in (place, *SENSOR[1:]):
            if key not in columns:
                draft.ask(f"{key}.column", f"Which column is: {ROWS[key].text}", {}, where)
    elif ("turn_depth" in columns or ({"depth_mm", "bevel_roll_deg"} <= {*table.headers})) and not entries:
        columns = {("turn_depth" if key == "depth" else key): value for key, value in columns.items()}
        entries, holds = [{}], "turns"
    if entries and not holds:
        holds = _find_kind(table, headers, entries, columns, draft, where)
    if len(entries) > 1 and holds == "shapes" and _is_array(table, headers, groups):
        if keys.get("layout") == "wide" or stated.table.get("layout") == "wide":
            wide = dict[str, Any]()
            for axis in (axis for axis in "xyz" if axis in entries[0]):
                columns_ = [one[axis]["column"] for one in entries if axis in one]
                wide[axis] = {**entries[0][axis], "column": columns_}
            entries = [wide]
        elif "layout" not in stated.table:
            question = (
                f"Each row has {len(entries)} places. What is a needle: each row, or each group of columns"
            )
            choices = {"rows": {"layout": "wide"}, "columns": {"layout": "long"}}
            draft.ask("layout", question, choices, where)
    if not entries:
        if not _draft_facts(table, columns, keys, draft, where):
            return
        entries = [{}]
    else:
        keys["holds"] = holds
    _add_unused(table, headers, taken, keys, draft, stated, where)
    for own in entries:
        completed = _complete(table, own | columns, keys, draft, stated)
        entry = {**keys, "columns": completed}
        draft.tables.append(entry)
        draft.laid.append(table)
        _add_missing(table, entry, draft)


def _are_tracks(table: Table, columns: Mapping[str, Any]) -> bool:
    """Whether each needle, if any is named, has depths that increase, and enough of them."""
    if "needle" not in columns and "time" not in columns:
        return _increase(table, columns, range(len(table.rows)))
    rows = dict[str, list[int]]()
    name = table.find(columns["needle"]["column"]) if "needle" in columns else None
    for n, row in enumerate(table.rows):
        rows.setdefault(row[name] if name is not None else "", []).append(n)
    return all(_increase(table, columns, own) for own in rows.values())


def _increase(table: Table, columns: Mapping[str, Any], rows: Sequence[int]) -> bool:
    column = table.find(columns["depth"]["column"])
    depths = [table.number(table.rows[n][column]) for n in rows] if column is not None else []
    known = [one for one in depths if one is not None]
    return len(known) >= MIN_READINGS and all(a < b for a, b in pairwise(known))


def _find_kind(
    table: Table,
    headers: Sequence[Header],
    entries: Sequence[Mapping[str, Any]],
    columns: Mapping[str, Any],
    draft: Draft,
    where: str,
) -> str:
    """Return whether points are of shapes, of tips, or of a tip on its way; what may be both is asked."""
    names = _list_names(table, columns)
    if len(entries) > 1:
        return "shapes"
    if names and len({*names}) == len(names) and not (len(names) >= MIN_POINTS and divide_labels(names)):
        if len(names) < MIN_POINTS or columns.keys() & {"depth", "entry_point", "bevel_side"}:
            return "tips"
        question = (
            "Each row has a name of its own. What are the rows: points of one needle (`shapes`), or `tips`"
        )
        draft.ask("holds", question, {one: {"holds": one} for one in ("shapes", "tips")}, where)
        return "shapes"
    time = table.find(columns["time"]["column"]) if "time" in columns else None
    is_log = (time is not None and _varies(table, columns, time)) or any(
        one.meaning == "quaternion" or one.group == "quaternion" for one in headers
    )
    depth = table.find(columns["depth"]["column"]) if "depth" in columns else None
    varies = depth is not None and _varies(table, columns, depth)
    if varies:
        draft.assumed["holds"] = "tracks: each row has a depth of its own"
        return "tracks"
    if is_log:
        question = (
            "What the rows are: points of `shapes` of needles, or readings of a tip on its way (`tracks`)"
        )
        choices = {one: {"holds": one} for one in ("shapes", "tracks")}
        draft.ask("holds", question, choices, where)
    return "shapes"


def _list_names(table: Table, columns: Mapping[str, Any]) -> list[str]:
    record = columns.get("needle", {})
    own = [
        table.find(name)
        for name in ([record["column"]] if "column" in record else [])
        if not isinstance(name, list)
    ]
    return [row[n] for row in table.rows for n in own if n is not None and row[n]]


def _varies(table: Table, columns: Mapping[str, Any], depth: int) -> bool:
    """Whether depths differ between rows of one needle."""
    own = dict[str, set[str]]()
    name = table.find(columns["needle"]["column"]) if "column" in columns.get("needle", {}) else None
    for row in table.rows:
        if row[depth]:
            own.setdefault(row[name] if name is not None else "", set()).add(row[depth])
    return any(len(values) > 1 for values in own.values())


def _is_array(
    table: Table, headers: Sequence[Header], groups: Mapping[tuple[int, str], Mapping[str, int]]
) -> bool:
    """Whether the places below a row of headers are numbered, and each row may be a needle."""
    if len(groups) < MIN_POINTS:
        return False
    stems = {re.sub(r"\d+", "#", name) for _, name in groups}
    beside = any(one.meaning in ("time", "needle") for one in headers)
    first = next(iter(groups.values()))
    return len(stems) == 1 and (beside or INDEX.search(headers[min(first.values())].text) is not None)


def _draft_facts(
    table: Table, columns: dict[str, Any], keys: dict[str, Any], draft: Draft, where: str
) -> bool:
    """Propose of what a table without points states facts; False, and a question, if of nothing known."""
    stated = [key for key in columns if key in ATTRIBUTES]
    keys["holds"] = "facts"
    if "needle" in columns and stated:
        keys["of"] = "needle"
    elif "specimen" in columns and len(stated) > 1:
        keys["of"] = "specimen"
    elif stated and len(table.rows) == 1:
        keys["of"] = "all"
    else:
        headers = ", ".join(text for text in table.headers if text)[:200]
        draft.unused.append(
            (f"table {where}", f"no column is known to hold coordinates: {headers or 'no headers'}")
        )
        return False
    return True


def _complete(
    table: Table, columns: dict[str, Any], keys: dict[str, Any], draft: Draft, stated: Stated
) -> dict[str, Any]:
    """Return columns with their units, labels of points divided, and the parts that are stated."""
    for meaning, record in columns.items():
        record.update(
            {key: value for key, value in stated.columns.get(meaning, {}).items() if key != "column"}
        )
        usual = MEANINGS[meaning].unit
        if stated.unit and meaning in COORDINATES and table.system is None:
            record["unit"] = stated.unit  # also beside a header that states another one
        elif usual in ("mm", "1/mm") and not record.get("unit") and "unit_column" not in record:
            unit_column = next(
                (n for n, text in enumerate(table.headers) if text.casefold() in ("unit", "units")), None
            )
            if unit_column is not None and any(row[unit_column] for row in table.rows):
                record["unit_column"] = _spell_name(table, unit_column)
        if "sign" in record:
            record["sign"] = int(record["sign"])
    names = _list_names(table, columns)
    if keys.get("holds") == "shapes" and len(names) > MIN_POINTS and len({*names}) == len(names):
        groups = divide_labels(names)
        if groups:
            columns["needle"]["pattern"] = r"(.+?)[-_ .]?\d+"
        else:
            del columns["needle"]  # a name of its own for each point is a label
    return columns


def _fill_down(table: Table, name: Any, keys: dict[str, Any], draft: Draft) -> Table:  # noqa: ANN401 - a column
    """Propose that a blank name is the one above, and return the table with these names.

    Names then stand in the first row of each block of points, or come again; else they are of single rows.
    """
    column = table.find(name) if not isinstance(name, list) else None
    texts = [row[column] for row in table.rows] if column is not None else []
    named = [n for n, text in enumerate(texts) if text]
    are_first = all(b - a > 1 for a, b in pairwise([*named, len(texts)]))
    is_repeated = len({*texts}) <= len(named)
    if column is None or named[:1] != [0] or all(texts) or not (are_first or is_repeated):
        return table
    keys["fill_down"] = [name]
    draft.assumed["fill_down"] = f"a blank {name} is the one above"
    rows = list[list[str]]()
    for row in table.rows:
        rows.append([*row[:column], row[column] or rows[-1][column], *row[column + 1 :]])
    return replace(table, rows=rows)


def _add_unused(
    table: Table,
    headers: Sequence[Header],
    taken: set[int],
    keys: dict[str, Any],
    draft: Draft,
    stated: Stated,
    where: str,
) -> None:
    """Name columns that nothing uses; numbers under an unknown header are asked about."""
    known = {str(name) for name in keys.get("unused", [])} | {*stated.table.get("unused", "").split("|")}
    for n, header in enumerate(headers):
        texts = [row[n] for row in table.rows if row[n]]
        if n in taken or not texts or header.text.casefold() in ("unit", "units"):
            continue
        name = _spell_name(table, n)
        draft.unused.append((f"column {name}", where))
        numbers = [table.number(text) for text in texts]
        is_count = not header.text and numbers == [*range(1, len(numbers) + 1)]
        is_known = bool(header.meaning or header.axis) or is_count or str(name) in known
        if not is_known and all(_QUANTITY.fullmatch(text) for text in texts):
            keys["unused"] = [*keys.get("unused", []), name]
            draft.assumed[f"unused.{name}"] = "numbers under a header that is not known"


def _add_missing(table: Table, entry: dict[str, Any], draft: Draft) -> None:
    """Propose which texts of coordinates mean that nothing was measured."""
    if entry["holds"] not in ("shapes", "tips", "tracks"):
        return
    texts = Counter[str]()
    for axis in ("x", "y", "z", "depth", "deflection"):
        record = entry["columns"].get(axis, {})
        names = record.get("column", ())
        for name in names if isinstance(names, list) else [names] if names != () else []:
            column = table.find(name)
            texts.update(row[column] for row in table.rows if column is not None)
    words = sorted(text for text in texts if text.lower() in MISSING or text in CODES)
    partly = _has_partial_rows(table, entry)
    if words or partly:
        entry.setdefault("missing", words)
        entry.setdefault("if_missing", "leave_out")
        shown = ", ".join([*words, *(["blank"] if partly else [])])
        draft.assumed["if_missing"] = f"leave_out: points with {shown} were not measured"


def _has_partial_rows(table: Table, entry: Mapping[str, Any]) -> bool:
    names = [entry["columns"][axis].get("column") for axis in "xyz" if axis in entry["columns"]]
    columns = [table.find(name) for name in names if name is not None and not isinstance(name, list)]
    cells = [[bool(row[n]) for n in columns if n is not None] for row in table.rows]
    return any(any(row) and not all(row) for row in cells)
