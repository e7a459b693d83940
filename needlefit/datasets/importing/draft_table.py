"""Propose what the columns of one table mean, and what its rows are; what is not sure is a question."""

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, pairwise, permutations
from types import MappingProxyType

from needlefit.datasets.importing.draft import Draft
from needlefit.datasets.importing.layout import BLOCK
from needlefit.datasets.importing.meanings import (
    MEANINGS,
    NAMED_BY_LAYER,
    VECTORS,
    Answers,
    Header,
    Keys,
    find_meaning,
    is_bore,
    name_axes,
    read_header,
    read_quantity,
    split_unit,
)
from needlefit.datasets.importing.tables import Table
from needlefit.datasets.observations.tip_track import MIN_READINGS
from needlefit.datasets.points import MIN_POINTS
from needlefit.grouping import group_values
from needlefit.project.locate import join_names
from needlefit.project.units import UNITS_MM

# meanings of columns x, y, z that are no points of a needle
NO_POINTS = (*VECTORS, "target", "guide", "quaternion")
OF_LAYERS = {*NAMED_BY_LAYER, "layers"}  # meanings of columns that state something of layers
EXCLUDED = "excluded"  # word of rows that are left out
_LENGTH = re.compile(r"\d+(?:[.,]\d+)?\s*(?:mm|cm)\b")  # pattern of a length in a header
MAX_FLAGS = 4  # largest number of values of a column that may mark rows to be left out


@dataclass(frozen=True)
class Column(Header):
    """A column: its header, its place, the name by which a mapping finds it, and its cells."""

    place: int = 0
    name: str | int = ""
    texts: Sequence[str] = ()  # of cells that are not blank
    numbers: Sequence[float] = ()  # of those that are numbers

    @property
    def is_curvature(self) -> bool:
        """Whether its unit is that of a curvature."""
        return self.unit.startswith("1/")

    @property
    def along_mm(self) -> float | None:
        """The place along a needle that its header states: 10 of `kappa @ 10 mm`."""
        quantity = read_quantity(match[0]) if (match := _LENGTH.search(self.text)) else None
        return None if quantity is None else quantity[0] * UNITS_MM[quantity[1]]


Columns = dict[str, list[Column]]  # by meaning
Records = dict[str, Keys]  # keys of `MeaningRecord` by meaning


class TableDraft:
    """Adds the entries of one table to a draft, and asks what it leaves open."""

    def __init__(self, table: Table, keys: Keys, draft: Draft) -> None:
        self.table, self.keys, self.draft = table, keys | draft.table_keys, draft
        self.name = table.sheet or table.path.name
        self.where = table.path.name + (f", sheet {table.sheet}" if table.sheet else "")
        parts = [
            [head[n] for head in table.first_headers if n < len(head)] for n in range(len(table.headers))
        ]
        headers = name_axes([*map(_read_column, table.headers, parts)])
        self.all = list[Column]()
        for n, header in enumerate(headers):
            texts = [row[n] for row in table.rows if row[n]]
            numbers = [value for text in texts if (value := table.number(text)) is not None]
            names = (text for text in (*parts[n][:1], table.headers[n]) if text and table.find(text) == n)
            self.all.append(
                Column(**vars(header), place=n, name=next(names, n + 1), texts=texts, numbers=numbers)
            )
        self.taken: Columns = {}
        self.excluded = list[str]()  # values of a column of flags that mark rows to be left out
        self.used = set[int]()  # places of columns that mean something, or are asked about

    def take_columns(self) -> None:
        """Take the columns whose meaning is stated or known; ask about those that may mean two things."""
        self._take_stated()
        self.groups = self._group_axes()
        self._take_known()
        if (block := self.table.find(BLOCK)) is not None:
            self.take("needle", [self.all[block]])
        if "fill_down" not in self.keys and (self.groups or self.taken.keys() & {"y", "deflection"}):
            self._fill_down()

    # ---- columns

    def list_free(self) -> list[Column]:
        """Return the columns with cells that mean nothing yet, and are not stated to mean nothing."""
        unused = self.keys.get("unused", ())
        return [
            column
            for column in self.all
            if column.texts and column.place not in self.used and column.name not in unused
        ]

    def _take_stated(self) -> None:
        """Take the columns that are stated; those of other tables are not here."""
        for meaning, parts in self.draft.columns.items():
            names = [name.strip() for name in parts.get("column", "").split("|") if name]
            places = [self._find_stated(name) for name in names]
            if places and None not in places:
                self.take(meaning, [self.all[n] for n in places if n is not None])
                self.draft.columns_read.add(meaning)
        self.draft.headers += filter(None, self.table.headers)

    def _find_stated(self, name: str) -> int | None:
        """Return the column of a stated header, in another unit too, or number; None if there is no one."""
        place = self.table.find(name)
        if place is None and name.isdecimal():
            return self.table.find(int(name))
        plain = split_unit(name)[0].strip()
        alike = [n for n, header in enumerate(self.table.headers) if split_unit(header)[0].strip() == plain]
        return alike[0] if place is None and len(alike) == 1 else place

    def take(self, meaning: str, columns: Sequence[Column]) -> None:
        """Let columns mean something, if nothing else does."""
        if columns and meaning not in self.taken:
            is_stated = "column" in self.draft.columns.get(meaning, {})
            is_single = MEANINGS[meaning].parts in ("", "points") and not is_stated
            self.taken[meaning] = [*columns[:1]] if is_single else [*columns]
            self.used |= {column.place for column in self.taken[meaning]}

    def _take_known(self) -> None:
        """Take the columns whose headers are known; ask where one may mean two things."""
        blocked = self.taken.keys() | ({"deflection", "deflection_z"} if "y" in self.taken else set())
        blocked |= {"thickness"} if "boundaries" in self.taken else set()
        proposed, free = defaultdict[str, list[Column]](list), self.list_free()
        meanings = {column.place: self._list_meanings(column) for column in free}
        for column in free:
            if len(meanings[column.place]) == 1:
                proposed[meanings[column.place][0]].append(column)
        if "boundaries" in proposed:
            proposed.pop("thickness", None)
        for meaning in (*VECTORS, "guide"):  # columns x, y and z of a place
            axes = {column.axis: column for column in free if column.group == meaning}
            if "y" in axes or (axes and meaning == "guide"):
                proposed[meaning] = [axes[axis] for axis in sorted(axes)]
        if "depth" in proposed and not (proposed.keys() | blocked) & {"y", "deflection"}:
            proposed["deflection"] = [
                column for column in proposed["tip"] if len(column.numbers) == len(column.texts)
            ]
        if "tool" in proposed:
            self._ask_tool_names(proposed)
        for key in [key for key in proposed if key not in MEANINGS or key in blocked or not proposed[key]]:
            del proposed[key]
        if "guide" in proposed and self.draft.values.get("guide") != "none":
            self.draft.assumed["guide"] = (
                f"{join_columns(proposed['guide'])}: by its header; guide=none if it is no guide"
            )
        if "needle" in proposed:
            proposed["needle"] = self._choose_names(proposed)
        for column in free:
            self.ask_meaning(column, meanings[column.place], proposed)
        trials = next((column for column in self.all if column.meaning == "trials"), None)
        if (
            trials
            and "point_sd" in proposed
            and any("mean" in text.casefold() for text in self.table.headers)
        ):
            (column,) = proposed.pop("point_sd")[:1]
            self.ask("point_sd", column=column, count=str(trials.name))
        if EXCLUDED in proposed:
            self._ask_excluded(proposed.pop(EXCLUDED)[0])
        for meaning, columns in proposed.items():
            self.take(meaning, columns)

    def _list_meanings(self, column: Column) -> list[str]:
        """Return what a column may mean, by its header and cells; an empty text: nothing here."""
        meaning, headers = column.meaning, {other.meaning for other in self.all}
        if meaning == "tangent" and "arc" not in headers:
            return [""]
        are_needles = [find_meaning("value", text).endswith("GPa") for text in column.texts]
        if meaning == "medium" and any(are_needles):
            is_clear = all(are_needles) and "modulus" not in headers
            return ["modulus"] if is_clear else ["medium", "modulus"]
        if is_bore(column.text, self.table.headers):
            return ["inner_diameter"]
        if meaning == "medium|specimen" and "source" in self.draft.columns.get("specimen", {}):
            return ["specimen"]  # as files or sheets of the needles are called
        if meaning == "pose" and column.unit == "deg":  # an angle about the needle, no direction of insertion
            return ["bevel_side", ""]
        if meaning == "guide" and "depth" not in headers and self.increases(column):  # of the stage
            return ["depth"]
        return meaning.split("|")

    def _choose_names(self, proposed: Columns) -> list[Column]:
        """Return the columns that name needles: the first in which names come again, and what divides it.

        Of facts it is the one with most names of the curves, if one has any.
        Ask whether points of one needle at several depths are of several scans.
        """
        rows, candidates = self.table.rows, proposed["needle"]
        repeated = [column for column in candidates if len({*column.texts}) < len(column.texts)]
        chosen = [*(repeated or candidates)[:1]]
        specimens = self.taken.get("specimen") or [
            column for column in self.all if "specimen" in column.meaning.split("|")
        ]
        has_points = self.groups or {"y", "deflection"} & (self.taken.keys() | proposed.keys())
        numbers = [len(self.draft.curves.intersection(column.texts)) for column in candidates]
        if not has_points and any(numbers):
            return [candidates[numbers.index(max(numbers))]]
        least = 2 if has_points else 1  # rows of a needle: one states facts of it

        def count_names(*more: Column) -> int:
            return len({tuple(row[column.place] for column in (*chosen, *more)) for row in rows})

        for column in (*repeated[1:], *specimens[:1]):
            if count_names() < count_names(column) <= len(rows) / least:
                chosen = [*chosen, column]
        for depth in proposed.get("depth", ()) if self.keys.get("holds") != "tracks" else ():
            if count_names() < count_names(depth) <= len(rows) / MIN_POINTS:
                scans = {"needle": [*chosen, depth]} | ({} if specimens else {"specimen": chosen[:1]})
                self.ask("column", {join_columns(scans["needle"]): name_columns(scans)}, key="needle")
        if len(chosen) > 1:
            self.draft.assumed["needle"] = f"{join_columns(chosen)}: together they name the needles"
        return chosen

    def _group_axes(self) -> dict[str, Columns]:
        """Return the columns of the points of each needle by its name, "" of a single one, and axis.

        A letter that comes again begins another needle. One column x may be of several: `x, y1, y2`.
        """
        if self.taken.keys() & {"y", "deflection"}:
            return {}
        groups: dict[tuple[int, str], Columns] = {}
        for column in self.list_free():
            axis, group = column.axis, column.group
            if axis and group not in NO_POINTS and not column.is_curvature:
                turn = next(k for k in count() if axis not in groups.get((k, group), ()))
                groups.setdefault((turn, group), {})[axis] = [column]
        with_x = [axes for axes in groups.values() if "x" in axes]
        if not with_x and not {"x", "depth"} & {*self.taken, *(column.meaning for column in self.all)}:
            pairs = [pair for axes in groups.values() for pair in permutations(axes.values(), 2)]
            answers: dict[str, Mapping[str, str]] = {
                str(along[0].name): name_columns({"x": along, "y": across}) for along, across in pairs
            }
            is_timed = any(column.meaning == "time" for column in self.all)
            if is_timed:  # another table has the depths at these times
                answers["depths at times, in another table"] = {"holds": "tracks"}
            if pairs and not (is_timed and self.keys.get("holds") == "tracks"):
                self.ask("column", answers, key="x")
        lacking = [axes for axes in groups.values() if "x" not in axes]
        if len(with_x) == 1 and all("y" in axes for axes in lacking):
            for axes in lacking:
                axes["x"] = with_x[0]["x"]
        named = [(name.strip(), axes) for (_, name), axes in groups.items() if "y" in axes]
        if len(named) == 1:
            return {"": named[0][1]}
        names = [name or f"{n}" for n, (name, _) in enumerate(named, 1)]
        return {
            name if names.count(name) == 1 else f"{name} {n}": axes
            for n, (name, (_, axes)) in enumerate(zip(names, named, strict=True), 1)
        }

    # ---- what is asked

    def ask(
        self, question: str, answers: Answers | None = None, column: Column | None = None, **parts: str | int
    ) -> None:
        """Ask a question of `QUESTIONS` about this table, or a column, which means nothing until then."""
        if column is not None:
            self.used.add(column.place)
            parts["name"] = column.name
        self.draft.ask(question, self.where, answers, **parts)

    def ask_meaning(self, column: Column, meanings: Sequence[str], proposed: Columns) -> None:
        """Ask which of several meanings a column has, if the first is not stated."""
        stated = proposed.keys() | self.taken.keys() | self.draft.values.keys()
        if len(meanings) < 2 or meanings[0] in stated:
            return
        answers = {
            meaning or "nothing": name_columns({meaning: [column]}) if meaning else _leave(column.name)
            for meaning in meanings
        }
        texts = [f"{meaning} ({MEANINGS[meaning].text})" if meaning else "not used" for meaning in meanings]
        cells = ", ".join(dict.fromkeys(column.texts))[:40]
        self.ask("meaning", answers, column, cells=cells, meanings=" or ".join(texts))

    def _ask_excluded(self, column: Column) -> None:
        """Ask which value marks rows that are left out, if there are several."""
        values = sorted({row[column.place] for row in self.table.rows})
        flags = {value: find_meaning("flag", value) for value in values}
        if all(flags.values()) and EXCLUDED in flags.values():
            self.take(EXCLUDED, [column])
            self.excluded = [value for value in values if flags[value] == EXCLUDED]
            self.draft.assumed[EXCLUDED] = (
                f"rows whose {column.name} is {join_names(self.excluded, MAX_FLAGS)}"
            )
            return
        if 1 < len(values) <= MAX_FLAGS:
            key, name = f"{EXCLUDED}.words", name_columns({EXCLUDED: [column]})
            answers = {value or "blank": name | {key: to_inline_table({value: EXCLUDED})} for value in values}
            self.ask(EXCLUDED, answers | {"none": _leave(column.name)}, column)

    def ask_tools(self, alone: Answers, guided: Answers, column: Column | None = None) -> None:
        """Ask which of several tools is the tip: `alone`, or, of two, `guided` by the other one."""
        answers = {f"{tip} alone": keys for tip, keys in alone.items()}
        for tip, guide in permutations(alone) if len(alone) == 2 else ():
            answers[f"{tip}, guided by {guide}"] = guided[tip]
        names = join_names([*alone], MAX_FLAGS)
        self.ask("tools", {**answers, "each": {"guide": "none"}}, column, names=names)

    def _ask_tool_names(self, proposed: Columns) -> None:
        """Take names of tools as those of needles; ask which of several that stand in rows is the tip."""
        (column,) = proposed.pop("tool")[:1]
        names = [*dict.fromkeys(column.texts)]
        if "guide" in self.draft.values or not 1 < len(names) <= MAX_FLAGS:
            proposed["needle"].append(column)
            return
        flags, alone = [column, *proposed.get(EXCLUDED, ())[:1]], dict[str, Mapping[str, str]]()
        lost = sorted({text for text in flags[-1].texts if find_meaning("flag", text) == EXCLUDED})
        for name in names:
            words = dict.fromkeys((*(other for other in names if other != name), *lost), EXCLUDED)
            alone[name] = name_columns({EXCLUDED: flags}) | {f"{EXCLUDED}.words": to_inline_table(words)}
        guided = dict(zip(names, ({"guide": name} for name in reversed(names)), strict=True))
        self.ask_tools(alone, guided, column)

    # ---- rows

    @cached_property
    def are_deflections(self) -> bool:
        """Whether rows hold deflections at depths, not places."""
        has_x = "deflection" not in self.draft.columns and any("x" in axes for axes in self.groups.values())
        return self.taken.keys() >= {"deflection", "depth"} and not has_x

    @cached_property
    def points(self) -> dict[str, Columns]:
        """The columns of the points by the name of their needle, "" of all; none where rows hold none."""
        self.used |= {column.place for column in self.axis_columns}
        key = "deflection" if self.are_deflections else "y"
        if self.taken.keys() >= {"arc", "tangent"}:
            return {"": {}}
        values = {meaning for meaning, parts in self.draft.columns.items() if "value" in parts}
        if key == "y" and not self.taken.keys() | values >= {"x", "y"}:
            return self.groups
        columns = self.taken[key]
        others = [column for column in self.list_free() if column.meaning == "deflection"]
        others += [column for axes in self.groups.values() for column in axes["y"]]
        if others and key not in self.draft.columns:
            self.ask_column(key, (*columns[:1], *others))
        if len(columns) == 1 or self.keys.get("layout") == "wide":
            return {"": {}}
        del self.taken[key]  # each is of a needle
        return {str(column.name): {key: [column]} for column in columns}

    def ask_column(
        self, meaning: str, columns: Sequence[Column] = (), further: Answers = MappingProxyType({})
    ) -> None:
        """Ask which column has a meaning, perhaps one of some; `further` answers state something else."""
        answers = {str(column.name): name_columns({meaning: [column]}) for column in columns}
        self.ask("column", {**answers, **further}, key=meaning)

    @cached_property
    def changing(self) -> set[str]:
        """What changes from row to row of a needle, as of a tip on its way: `depth`, `time`."""
        is_turned = any("quaternion" in (column.meaning, column.group) for column in self.all)
        changing = {
            meaning
            for meaning in ("depth", "time")
            for column in self.taken.get(meaning, ())
            if any(len({*numbers}) > 1 for numbers in self._list_by_needle(column))
        }
        return changing | {"time"} if is_turned else changing

    @property
    def names(self) -> Sequence[str]:
        """The names in the one column of needles; none of several columns."""
        columns = self.taken.get("needle", [])
        return columns[0].texts if len(columns) == 1 else []

    @property
    def names_rows(self) -> bool:
        """Whether each row of the points of one needle has a name of its own."""
        return len(self.groups) < 2 and bool(self.names) and len({*self.names}) == len(self.names)

    @property
    def axis_columns(self) -> list[Column]:
        """The columns of coordinates."""
        return [column for axes in self.groups.values() for (column,) in axes.values()]

    def _list_by_needle(self, column: Column) -> list[list[float]]:
        """Return the numbers in a column of each needle."""
        names = self.taken.get("needle", [column for column in self.all if column.meaning == "needle"])
        cells = [
            ([row[name.place] for name in names], self.table.number(row[column.place]))
            for row in self.table.rows
        ]
        return [*group_values((tuple(name), value) for name, value in cells if value is not None).values()]

    def increases(self, column: Column) -> bool:
        """Whether the numbers of each needle increase from row to row."""
        runs = self._list_by_needle(column)
        return bool(runs) and all(
            len(numbers) >= MIN_READINGS and all(a < b for a, b in pairwise(numbers)) for numbers in runs
        )

    # ---- cells

    def _fill_down(self) -> None:
        """Propose that a blank name is the one above.

        Names then stand in the first row of each block of points; else they name single rows.
        """
        if not self.names:
            return
        (column,) = self.taken["needle"]
        texts = [row[column.place] for row in self.table.rows]
        named = [n for n, text in enumerate(texts) if text]
        are_first = all(b - a > 1 for a, b in pairwise([*named, len(texts)]))
        if all(texts) or named[0] or not are_first:
            return
        self.keys["fill_down"] = [column.name]
        self.draft.assumed["fill_down"] = f"{column.name}: a blank cell is the one above"
        self.table = self.table.fill_down([column.name])
        self.taken["needle"] = [replace(column, texts=[row[column.place] for row in self.table.rows])]

    def list_unknown(self) -> list[Column]:
        """Return the columns of numbers that nothing uses, under headers that are not known."""
        return [
            column
            for column in self.list_free()
            if not column.is_known and len(column.numbers) == len(column.texts)
            if column.text or [*column.numbers] != [*range(1, len(column.texts) + 1)]
        ]


def join_columns(columns: Iterable[Column]) -> str:
    """Return the names of columns."""
    return ", ".join(str(column.name) for column in columns)


def name_columns(columns: Mapping[str, Sequence[Column]]) -> dict[str, str]:
    """Return the keys that state columns by meaning."""
    return {
        f"{meaning}.column": "|".join(str(column.name) for column in of_meaning)
        for meaning, of_meaning in columns.items()
    }


def name_points(points: Iterable[Columns]) -> dict[str, dict[str, str]]:
    """Return the keys that state the columns of the points of needles, by the first of each."""
    keys = map(name_columns, points)
    return {next(iter(of_needle.values())): of_needle for of_needle in keys}


def _leave(name: str | int) -> dict[str, str]:
    """Return the keys that leave a column out."""
    return {"unused": json.dumps([name])}


def _read_column(text: str, parts: Sequence[str]) -> Header:
    """Return what the texts above a column mean: all together, else one of them, the lowest first."""
    read_headers = [read_header(header) for header in dict.fromkeys((text, *reversed(parts))) if header]
    best = next((header for header in read_headers if header.is_known), Header(text))
    unit = best.unit or next((header.unit for header in read_headers if header.unit), "")
    return replace(best, text=text, unit=unit)


def to_inline_table(words: Mapping[str, str]) -> str:
    """Return an inline table of TOML, as `--set` takes it."""
    return f"{{{', '.join(f'{json.dumps(key)} = {json.dumps(value)}' for key, value in words.items())}}}"
