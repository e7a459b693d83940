"""Propose what the columns of one table mean, and what its rows are."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import count, pairwise, permutations
from typing import Any

from needlefit.datasets.importing.assignments import Assignments
from needlefit.datasets.importing.draft import Draft
from needlefit.datasets.importing.layout import MISSING
from needlefit.datasets.importing.meanings import ATTRIBUTES, MEANINGS, ROWS, SENSOR, VECTORS
from needlefit.datasets.importing.stated import name_set
from needlefit.datasets.importing.synonyms import (
    INDEX,
    Header,
    find_meaning,
    is_side,
    name_axes,
    read_header,
    translate_side,
)
from needlefit.datasets.importing.tables import BLOCK, UNIT_FIELDS, Table
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS
from needlefit.datasets.tip_tracks import MIN_READINGS
from needlefit.project.units import UNITS_GPA

CODES = ("-999", "-999.0", "-9999", "-9999.0", "-99", "999", "9999")  # numbers that stand for no measurement
NO_POINTS = (*VECTORS, "target", "guide", "quaternion")  # columns x, y, z that are no points of a needle
COORDINATES = ("x", "y", "z", "depth", "deflection", "deflection_z", "guide")
SEVERAL = (*VECTORS, "boundaries", "guide", "needle")  # meanings that may have several columns
POINTS = ("shapes", "tips", "tracks")  # rows that hold points
EXCLUDED = "excluded"  # the word of rows that are left out
MIN_NEEDLE_GPA = 1.0  # smallest modulus (GPa) that can only be that of a needle
MAX_FLAGS = 4  # largest number of values of a column that may mark rows to be left out
_QUANTITY = re.compile(r"\D{0,3}[-+]?\d+([.,]\d+)?\s*\S{0,4}")  # a number with a unit: 22G, 0,7 mm

Axes = dict[str, int]  # columns by axis
Columns = dict[str, dict[str, Any]]  # keys of `MeaningRecord` by meaning


class TableDraft:
    """Adds the entries of one table to a draft, and asks what it leaves open."""

    def __init__(
        self, table: Table, keys: dict[str, Any], draft: Draft, stated: Assignments, unit: str = ""
    ) -> None:
        self.table, self.keys, self.draft, self.stated = table, keys | stated.table, draft, stated
        self.unit = stated.unit or unit  # of lengths whose header states none
        self.where = table.path.name + (f", sheet {table.name}" if "sheet" in keys else "")
        texts = [
            [head[n] for head in table.first_headers if n < len(head)] for n in range(len(table.headers))
        ]
        self.headers, self.signs = name_axes([*map(_read_column, table.headers, texts)])
        self.columns = Columns()
        self.used = set[int]()

    def propose(self) -> None:
        """Propose columns, the kind of rows, and the entries."""
        self._take_stated()
        groups = self._group_axes()
        known_columns = self._list_known()
        self._ask_ambiguous(known_columns)
        for meaning in known_columns:
            self._take(meaning, known_columns[meaning])
        if "needle" not in self.columns and (block := self.table.find(BLOCK)) is not None:
            self._take("needle", [block])
        if self.columns.keys() & {*SENSOR[1:3]} and "point_sd" in self.columns:
            deviation = self.columns.setdefault("curvature_sd", self.columns.pop("point_sd"))
            deviation["unit"] = _per(deviation.get("unit", ""))
        if "fill_down" not in self.keys and (groups or self.columns.keys() & {"y", "deflection"}):
            self._fill_down()
        entries, holds = self._find_rows([*groups.items()])
        if not entries and not (holds := self._find_facts()):
            headers = ", ".join(text for text in self.table.headers if text)[:200]
            problem = f"no column is known to hold coordinates: {headers or 'no headers'}"
            self.draft.unused.append((f"table {self.where}", problem))
            self._ask_layers(headers)
            return
        self.keys["holds"] = holds
        self._keep_words()
        self._name_unused()
        for entry in entries or [{}]:
            self._add(entry | self.columns)

    # ---- columns

    def _take_stated(self) -> None:
        """Take the columns that are stated; those of other tables are not here."""
        for meaning, parts in self.stated.columns.items():
            names = parts["column"].split("|") if "column" in parts else []
            places = [self._find(name.strip()) for name in names]
            if places and None not in places:
                self._take(meaning, [n for n in places if n is not None])
                self.draft.columns_read.add(meaning)
        self.draft.headers += [text for text in self.table.headers if text]

    def _find(self, name: str) -> int | None:
        column = self.table.find(name)
        return self.table.find(int(name)) if column is None and name.isdecimal() else column

    def _take(self, meaning: str, places: Sequence[int]) -> None:
        """Let columns mean something, if nothing else does."""
        if places and meaning not in self.columns:
            kept = (
                places
                if meaning in SEVERAL or "column" in self.stated.columns.get(meaning, {})
                else places[:1]
            )
            self.columns[meaning] = self._spell(meaning, kept)
            self.used |= {*kept}

    def _spell(self, meaning: str, places: Sequence[int]) -> dict[str, Any]:
        """Return how a mapping names columns, and the unit of the first."""
        names, unit = [self._name(n) for n in places], self.headers[places[0]].unit
        unit = _per(unit) if meaning.startswith("curvature") else unit
        axes = "".join(self.headers[n].axis for n in places) if meaning == "guide" else ""
        spelled = {"column": names[0] if len(names) == 1 else names, "unit": unit, "axes": axes}
        return {key: value for key, value in spelled.items() if value}

    def _name(self, n: int) -> str | int:
        """Return the first row's header of a column, else all of them, else its number: what is unique."""
        first = [head[n] for head in self.table.first_headers[:1] if n < len(head)]
        texts = (text for text in (*first, self.table.headers[n]) if text and self.table.find(text) == n)
        return next(texts, n + 1)

    def _list_known(self) -> dict[str, list[int]]:
        """Return the columns of each meaning that headers name, beside what is stated."""
        blocked = {*self.columns}
        if "y" in blocked:
            blocked |= {"deflection", "deflection_z"}
        places_by_meaning = dict[str, list[int]]()
        for n, header in enumerate(self.headers):
            if n not in self.used and header.meaning in MEANINGS and (texts := self._list_texts(n)):
                is_needle = header.meaning == "medium" and all(map(_is_needle_material, texts))
                places_by_meaning.setdefault("modulus" if is_needle else header.meaning, []).append(n)
        for meaning in (*VECTORS, "guide"):  # columns x, y and z of a place
            places = {
                header.axis: n
                for n, header in enumerate(self.headers)
                if header.group == meaning and n not in self.used
            }
            if "y" in places or (places and meaning == "guide"):
                places_by_meaning[meaning] = [places[axis] for axis in sorted(places)]
        places_by_meaning = {
            meaning: places for meaning, places in places_by_meaning.items() if meaning not in blocked
        }
        if "depth" in places_by_meaning and not places_by_meaning.keys() & {"y", "deflection"}:
            tips = [n for n, header in enumerate(self.headers) if header.meaning == "tip"]
            tips = [n for n in tips if all(map(self._is_number, self._list_texts(n)))]
            if tips and not {"y", "deflection"} & blocked:
                places_by_meaning["deflection"] = tips
        if "guide" in places_by_meaning:
            names = ", ".join(str(self._name(n)) for n in places_by_meaning["guide"])
            self.draft.assumed["guide"] = f"{names}: by its header; guide=none if it is no guide"
        if "needle" in places_by_meaning:
            self._choose_names(places_by_meaning)
        return places_by_meaning

    def _is_number(self, text: str) -> bool:
        return self.table.number(text) is not None

    def _list_texts(self, n: int) -> list[str]:
        """Return the cells of a column that are not blank."""
        return [row[n] for row in self.table.rows if row[n]]

    def _group_axes(self) -> dict[str, Axes]:
        """Return the columns of the points of each needle by its name, and axis.

        A letter that comes again begins another needle. One column x may be of several: `x, y1, y2`.
        """
        if self.columns.keys() & {"y", "deflection"}:
            return {}
        groups: dict[tuple[int, str], Axes] = {}
        for n, header in enumerate(self.headers):
            is_free = n not in self.used and bool(self._list_texts(n))  # an empty column is not there
            if header.axis and header.group not in NO_POINTS and is_free:
                turn = next(k for k in count() if header.axis not in groups.get((k, header.group), ()))
                groups.setdefault((turn, header.group), {})[header.axis] = n
        if "x" not in self.columns and not any(header.meaning == "depth" for header in self.headers):
            for axes in groups.values():
                self._name_along(axes)
        with_x = [key for key, axes in groups.items() if "x" in axes]
        lacking = [axes for axes in groups.values() if "x" not in axes]
        if len(with_x) == 1 and lacking and all("y" in axes for axes in lacking):
            for axes in lacking:
                axes["x"] = groups[with_x[0]]["x"]
        named = [(name.strip(), axes) for (_, name), axes in groups.items() if "y" in axes]
        names = [name or f"{n}" for n, (name, _) in enumerate(named, 1)]
        return {
            name if names.count(name) == 1 else f"{name} {n}": axes
            for n, (name, (_, axes)) in enumerate(zip(names, named, strict=True), 1)
        }

    def _name_along(self, axes: Axes) -> None:
        """Let y or z be x, along the needle, in a table without x: that of them which spans more."""
        if axes.keys() != {"y", "z"}:
            return
        numbers = {
            axis: [value for text in self._list_texts(n) if (value := self.table.number(text)) is not None]
            for axis, n in axes.items()
        }
        across, along = sorted(
            "yz", key=lambda axis: max(numbers[axis], default=0) - min(numbers[axis], default=0)
        )
        axes["x"], axes["y"] = axes[along], axes[across]
        del axes["z"]
        self.draft.assumed["x"] = f"column {self._name(axes['x'])}: it spans more, and no column is called x"

    def _choose_names(self, known_columns: dict[str, list[int]]) -> None:
        """Keep the columns that name needles: the first in which names come again, and what divides it."""
        rows = self.table.rows
        candidates = known_columns["needle"]
        repeated = [n for n in candidates if len({*self._list_texts(n)}) < len(self._list_texts(n))]
        chosen = (repeated or candidates)[:1]
        for n in (*repeated[1:], *known_columns.get("specimen", [])[:1]):
            names = {tuple(row[m] for m in (*chosen, n)) for row in rows}
            divided = len({tuple(row[m] for m in chosen) for row in rows})
            if divided < len(names) <= len(rows) / 2:
                chosen = [*chosen, n]
        if len(chosen) > 1:
            columns = ", ".join(str(self._name(n)) for n in chosen)
            self.draft.assumed["needle"] = f"{columns}: together they name the needles"
        known_columns["needle"] = chosen

    # ---- what is asked

    def _ask(
        self, name: str, n: int, answers: Mapping[str, Mapping[str, str]] | None = None, **parts: str
    ) -> None:
        """Ask what a column is; until then it means nothing."""
        self.used.add(n)
        self.draft.ask(name, self.where, answers, name=str(self._name(n)), **parts)

    def _ask_ambiguous(self, known_columns: dict[str, list[int]]) -> None:
        """Ask what words mean that labs use in two ways."""
        stated = known_columns.keys() | self.columns.keys() | self.draft.values.keys()
        words = {header.meaning: n for n, header in enumerate(self.headers) if self._list_texts(n)}
        if "bevel_angle" in words and "bevel_side" not in stated:
            self._ask("bevel_angle", words["bevel_angle"])
        is_mean = any("mean" in text.casefold() for text in self.table.headers)
        if "point_sd" in known_columns and "trials" in words and is_mean:
            self._ask("point_sd", known_columns.pop("point_sd")[0], count=str(self._name(words["trials"])))
        moduli = known_columns.get("modulus", [])
        materials = [n for n in moduli if any(map(_is_needle_material, self._list_texts(n)))]
        is_open = len(materials) < len(moduli) and "modulus" not in self.draft.values
        for places in (known_columns.get("medium", []), moduli if is_open else []):
            for n in [n for n in places if any(map(_is_needle_material, self._list_texts(n)))]:
                places.remove(n)
                self._ask("material", n)
        if moduli and "modulus" in self.draft.values:
            self.used |= {*known_columns.pop("modulus")}
        elif "modulus" in known_columns:
            place, unit = known_columns["modulus"][0], self.headers[known_columns["modulus"][0]].unit or "GPa"
            numbers = [value for text in self._list_texts(place) if (value := self.table.number(text))]
            if any(value * UNITS_GPA.get(unit, 1.0) < MIN_NEEDLE_GPA for value in numbers):
                self._ask("modulus", known_columns.pop("modulus")[0], unit=unit)
        if "phantom" in words and "medium" not in stated and words["phantom"] not in self.used:
            several = len({*self._list_texts(words["phantom"])}) > 1 and "specimen" not in stated
            if several:
                self._ask("medium", words["phantom"])
            else:
                known_columns["medium"] = [words["phantom"]]
        if EXCLUDED in known_columns:
            self._ask_excluded(known_columns.pop(EXCLUDED)[0])

    def _ask_excluded(self, n: int) -> None:
        """Ask which value marks rows that are left out, if there are several."""
        name, values = str(self._name(n)), sorted({row[n] for row in self.table.rows})
        if 1 < len(values) <= MAX_FLAGS and name not in self.keys.get("unused", ()):
            answers = {
                value or "blank": {
                    f"{EXCLUDED}.column": name,
                    f"{EXCLUDED}.words": _to_toml({value: EXCLUDED}),
                }
                for value in values
            }
            self._ask(EXCLUDED, n, answers | {"none": {"unused": f'["{name}"]'}})

    # ---- rows

    def _find_rows(self, groups: Sequence[tuple[str, Axes]]) -> tuple[list[Columns], str]:
        """Return the columns of each needle, or of all needles, and what rows are; nothing of facts."""
        columns, holds = self.columns, self.keys.get("holds", "")
        if holds == "curvatures":
            self._ask_curvatures()
            return [{}], holds
        entries = list[Columns]()
        for name, axes in groups:
            records = {axis: self._spell(axis, [n]) for axis, n in axes.items()}
            for axis in records.keys() & self.signs.keys():
                records[axis]["sign"] = self.signs[axis]
            if "needle" not in columns and len(groups) > 1:
                records["needle"] = {"value": name}
            entries.append(records)
            self.used |= {*axes.values()}
        has_x = "deflection" not in self.stated.columns and any("x" in entry for entry in entries)
        if columns.keys() >= {"deflection", "depth"} and not has_x:
            self._ask_deflection(entries)
            increase = self._have_depths(_increase)
            if increase and not holds:
                other = name_set("holds", "shapes")
                self.draft.assumed["holds"] = f"tracks: the depths of each needle increase; points: {other}"
            entries = [{}]
            if len(deflections := self._list_columns(columns["deflection"])) > 1:  # of a needle each
                del columns["deflection"]
                names = [{"value": str(self._name(n))} for n in deflections]
                entries = [
                    {"deflection": self._spell("deflection", [n]), "needle": name}
                    for n, name in zip(deflections, names, strict=True)
                ]
            return entries, holds or ("tracks" if increase else "tips")
        if columns.keys() >= {"x", "y"}:
            entries = [{}]
        if entries and not holds:
            holds = self._find_kind(groups)
        if entries:
            return self._divide_groups(entries, groups, holds), holds
        return ([{}], "curvatures") if self._ask_curvatures() else self._find_other_rows()

    def _ask_curvatures(self) -> bool:
        """Whether rows hold curvatures, as headers or the unit of their numbers state; ask which is which."""
        inverse = [
            str(self._name(n))
            for n, header in enumerate(self.headers)
            if n not in self.used and header.unit.startswith("1/")
        ]
        if not (inverse or self.columns.keys() & {*SENSOR[1:3]} or self.keys.get("holds") == "curvatures"):
            return False
        place = "sensor_from_base" if "sensor_from_base" in self.columns else "sensor"
        lacking = [key for key in (place, *SENSOR[1:3]) if key not in self.columns]
        if {*SENSOR[1:3]} <= {*lacking} and len(inverse) > 1:
            answers = {
                f"{up}, {right}": {"curvature_y.column": up, "curvature_z.column": right}
                for up, right in permutations(inverse, 2)
            }
            self.draft.ask("curvatures", self.where, answers, names=", ".join(inverse))
            lacking = [key for key in lacking if key == place]
        for key in lacking:
            self.draft.ask("column", self.where, key=key, text=ROWS[key].text)
        return True

    def _find_other_rows(self) -> tuple[list[Columns], str]:
        """Return what rows hold that are neither points nor curvatures: turns, or nothing of facts."""
        columns = self.columns
        if "turn_depth" in columns or {"depth_mm", "bevel_roll_deg"} <= {*self.table.headers}:
            self.columns = {
                ("turn_depth" if key == "depth" else key): column for key, column in columns.items()
            }
            return [{}], "turns"
        if "depth" in columns and "needle" not in columns and len(unknown := self._list_unknown()) > 1:
            heads = [str(self._name(n)) for n in unknown]
            columns_text, listed = "|".join(heads), f"`{'`, `'.join(heads)}`"
            self.draft.ask(
                "deflections", self.where, names=listed, columns=columns_text, unused=json.dumps(heads)
            )
        return [], ""

    def _ask_layers(self, headers: str) -> None:
        """Ask what a table that is not used states of layers."""
        name = self.table.name if "sheet" in self.keys else self.table.path.name
        is_of_layers = any(header.meaning in ("boundaries", "layers") for header in self.headers)
        if is_of_layers and "boundaries" not in self.draft.values and name not in self.keys.get("unused", ()):
            self.draft.ask("table", self.where, name=name, headers=headers)

    def _ask_deflection(self, entries: Sequence[Columns]) -> None:
        """Ask which of several columns is the deflection."""
        others = [
            n
            for n, header in enumerate(self.headers)
            if header.meaning == "deflection" and n not in self.used
        ]
        names = [*map(self._name, [*self._list_columns(self.columns["deflection"])[:1], *others])]
        names += [entry["y"]["column"] for entry in entries]
        if len(names) > 1 and "deflection" not in self.stated.columns:
            answers = {str(name): {"deflection.column": str(name)} for name in names}
            self.draft.ask("deflection", self.where, answers)

    def _find_kind(self, groups: Sequence[tuple[str, Axes]]) -> str:
        """Return whether points are of shapes, of tips, or of a tip on its way; what may be both is asked."""
        columns, names = self.columns, self._list_names()
        is_single = len(groups) < 2 and bool(names) and len({*names}) == len(names)
        has_x = "x" in columns or any("x" in axes for _, axes in groups)
        if is_single and "depth" in columns and not has_x:
            return "tips"
        if is_single and not (len(names) >= MIN_POINTS and divide_labels(names)):
            if len(names) < MIN_POINTS or columns.keys() & {"depth", "entry_point", "bevel_side"}:
                return "tips"
            self.draft.ask("labels", self.where)
            return "shapes"
        is_tip = any(
            self.headers[n].beside in ("tip", "deflection") for _, axes in groups for n in axes.values()
        )
        has_poses = any("quaternion" in (header.meaning, header.group) for header in self.headers)
        is_log = has_poses or self._have_depths(_differ, "time")
        if len(groups) < 2 and self._have_depths(_differ) and (is_tip or is_log):
            other = name_set("holds", "shapes")
            self.draft.assumed["holds"] = f"tracks: each row has a depth of its own; points: {other}"
            return "tracks"
        if len(groups) < 2 and is_tip and is_log:
            self.draft.assumed["holds"] = "tracks: each row has a time, and the place of a tip"
            return "tracks"
        if (is_log and not self._is_array(groups)) or (len(groups) < 2 and self._have_depths(_differ)):
            self.draft.ask("readings", self.where)
        return "shapes"

    def _list_columns(self, record: Mapping[str, Any]) -> list[int]:
        """Return the columns that a record names."""
        names = record.get("column", [])
        named = map(self.table.find, names if isinstance(names, list) else [names])
        return [n for n in named if n is not None]

    def _list_names(self) -> list[str]:
        """Return the names in the one column of needles; none of several columns."""
        columns = self._list_columns(self.columns.get("needle", {}))
        return self._list_texts(columns[0]) if len(columns) == 1 else []

    def _have_depths(self, test: Callable[[list[float]], bool], meaning: str = "depth") -> bool:
        """Whether depths, or times, pass a test: those of all needles, that they increase, else of any."""
        named = self._list_columns(self.columns.get("needle", {}))
        numbers = dict[tuple[str, ...], list[float]]()
        for row in self.table.rows:
            for column in self._list_columns(self.columns.get(meaning, {})):
                if (value := self.table.number(row[column])) is not None:
                    numbers.setdefault(tuple(row[n] for n in named), []).append(value)
        return bool(numbers) and (all if test is _increase else any)(map(test, numbers.values()))

    def _is_array(self, groups: Sequence[tuple[str, Axes]]) -> bool:
        """Whether the places below a row of headers are numbered, and each row may be a needle."""
        if len(groups) < MIN_POINTS or self.keys.get("layout") == "long":
            return False
        stems = {re.sub(r"\d+", "#", name) for name, _ in groups}
        beside = any(header.meaning in ("time", "needle") for header in self.headers)
        first = self.headers[min(groups[0][1].values())].text
        return len(stems) == 1 and (beside or INDEX.search(first) is not None)

    def _divide_groups(
        self, entries: list[Columns], groups: Sequence[tuple[str, Axes]], holds: str
    ) -> list[Columns]:
        """Return the columns of each needle: groups are needles, or points of a row, or one is asked for."""
        if len(entries) > 1 and holds == "shapes" and self._is_array(groups):
            if self.keys.get("layout") != "wide":
                self.draft.ask("layout", self.where, count=str(len(groups)))
                return entries
            axes = [axis for axis in "xyz" if axis in entries[0]]
            return [
                {
                    a: entries[0][a] | {"column": [entry[a]["column"] for entry in entries if a in entry]}
                    for a in axes
                }
            ]
        is_version = any(find_meaning("version", name.split(" ")[0]) for name, _ in groups)
        if len(entries) > 1 and holds == "shapes" and ("needle" in self.columns or is_version):
            answers = {
                next(iter(entry.values()))["column"]: {
                    f"{axis}.column": record["column"]
                    for axis, record in entry.items()
                    if axis in ("x", "y", "z")
                }
                for entry in entries
            }
            names = " and ".join(f"`{name}`" for name in answers)
            self.draft.ask(
                "points", self.where, {str(name): keys for name, keys in answers.items()}, names=names
            )
        has_x = "x" in entries[0] or "x" in self.columns
        if holds == "shapes" and not has_x and "depth" in self.columns:
            self.columns["x"] = self.columns.pop("depth")  # points at depths
        return entries

    def _find_facts(self) -> str:
        """Return `facts` if a table without points states some, and propose of what; else nothing."""
        stated = [key for key in self.columns if key in ATTRIBUTES]
        if "needle" in self.columns and stated:
            self.keys["of"] = "needle"
        elif "specimen" in self.columns and len(stated) > 1:
            self.keys["of"] = "specimen"
        elif stated and len(self.table.rows) == 1:
            self.keys["of"] = "all"
        else:
            return ""
        return "facts"

    # ---- cells

    def _fill_down(self) -> None:
        """Propose that a blank name is the one above.

        Names then stand in the first row of each block of points, or come again; else they name single rows.
        """
        columns = self._list_columns(self.columns.get("needle", {}))
        if len(columns) != 1:
            return
        column, name = columns[0], self._name(columns[0])
        texts = [row[column] for row in self.table.rows]
        named = [n for n, text in enumerate(texts) if text]
        are_first = all(b - a > 1 for a, b in pairwise([*named, len(texts)]))
        is_repeated = len({*texts}) <= len(named)
        if named[:1] != [0] or all(texts) or not (are_first or is_repeated):
            return
        self.keys["fill_down"] = [name]
        self.draft.assumed["fill_down"] = f"{name}: a blank cell is the one above"
        rows = list[list[str]]()
        for row in self.table.rows:
            rows.append([*row[:column], row[column] or rows[-1][column], *row[column + 1 :]])
        self.table = replace(self.table, rows=rows)

    def _keep_words(self) -> None:
        """Ask about a column of two directions under an unknown header; name those of other two words."""
        for n in range(len(self.headers)):
            name, texts = str(self._name(n)), [*dict.fromkeys(row[n] for row in self.table.rows)]
            is_number = any(self.table.number(text) is not None for text in texts)
            if len(texts) != 2 or not all(texts) or is_number or self._is_known(n):
                continue
            words = ", ".join(texts)
            self.draft.words.append(f"column {name} ({words})")
            if "bevel_side" not in self.draft.values and all(
                translate_side(text, "") != text for text in texts
            ):
                self._ask("side_words", n, words=words)

    def _is_known(self, n: int) -> bool:
        """Whether something uses a column, its header is known, or it is stated to mean nothing."""
        header, is_unused = self.headers[n], self._name(n) in self.keys.get("unused", [])
        is_unit = header.text.casefold() in UNIT_FIELDS
        return n in self.used or is_unused or is_unit or bool(header.meaning or header.axis)

    def _name_unused(self) -> None:
        """Name columns that nothing uses; numbers under an unknown header are assumed to mean nothing."""
        for n, header in enumerate(self.headers):
            if n not in self.used and self._list_texts(n) and header.text.casefold() not in UNIT_FIELDS:
                self.draft.unused.append((f"column {self._name(n)}", self.where))
                if "bevel" in header.text.casefold():
                    self.draft.words.append(f"column {self._name(n)}")
        names = [self._name(n) for n in self._list_unknown()]
        for name in names:
            self.draft.assumed[f"unused.{name}"] = "not used: numbers under a header that is not known"
        if unused := [*self.keys.get("unused", []), *names]:
            self.keys["unused"] = unused

    def _list_unknown(self) -> list[int]:
        """Return the columns of numbers that nothing uses, under headers that are not known."""
        unknown = list[int]()
        for n, header in enumerate(self.headers):
            texts = self._list_texts(n)
            numbers = [self.table.number(text) for text in texts]
            is_count = not header.text and numbers == [*range(1, len(numbers) + 1)]
            if texts and not is_count and not self._is_known(n):
                unknown += [n] if all(map(_QUANTITY.fullmatch, texts)) else []
        return unknown

    def _add(self, columns: Columns) -> None:
        """Add an entry, with units, words, labels of points, and what was not measured."""
        holds = self.keys["holds"]
        columns = {meaning: dict(record) for meaning, record in columns.items()}
        for meaning, parts in self.stated.columns.items():
            beside = {key: part for key, part in parts.items() if key != "column"}
            if meaning in columns or (beside.keys() & {"source", "value"} and holds in POINTS):
                columns[meaning] = columns.get(meaning, {}) | beside
        for meaning, record in columns.items():
            self._complete(meaning, record)
        guide = columns.get("guide", {"axes": ""})
        is_guide = holds == "tracks" and self.draft.values.get("guide") != "none"
        if is_guide and "deflection" not in columns and "axes" not in guide:
            self.draft.ask("guide", self.where, name=str(guide["column"]))
        names = self._list_names()
        if holds == "tips" and "needle" not in columns:
            count = len(self.table.rows)
            self.draft.assumed["needle"] = f"{count} needles, one a row: no column names them"
        if holds == "shapes" and len(names) > MIN_POINTS and len({*names}) == len(names):
            if divide_labels(names):
                columns["needle"]["pattern"] = r"(.+?)[-_ .]?\d+"
            else:
                del columns["needle"]  # a name of its own for each point is a label
        elif holds in POINTS and names:
            self._exclude_statistics(columns, {*names})
            place = (self.table.path.name, self.table.name, holds == "tips")
            self.draft.needles.setdefault(place, set()).update(names)
        entry = {**self.keys, "columns": columns}
        if holds in POINTS:
            self._find_missing(entry)
        self.draft.add(entry, self.table.path)

    def _complete(self, meaning: str, record: dict[str, Any]) -> None:
        """Add a unit that the header does not state, and words for the sides of bevels."""
        if self.stated.unit and meaning in COORDINATES and self.table.system is None:
            record["unit"] = self.stated.unit  # also beside a header that states another one
        elif (
            MEANINGS[meaning].unit in ("mm", "1/mm")
            and not record.get("unit")
            and "unit_column" not in record
        ):
            column = next(
                (n for n, text in enumerate(self.table.headers) if text.casefold() in UNIT_FIELDS), None
            )
            if column is not None and self._list_texts(column):
                record["unit_column"] = self._name(column)
            elif self.unit and meaning in COORDINATES and self.table.system is None:
                record["unit"] = self.unit
            elif meaning in ATTRIBUTES and not (meaning in COORDINATES and self.keys["holds"] in POINTS):
                self._assume_mm(meaning, record)
        if meaning == "bevel_side":
            unit = record.get("unit", "")
            texts = dict.fromkeys(text for n in self._list_columns(record) for text in self._list_texts(n))
            words = {text: side for text in texts if (side := translate_side(text, unit)) != text}
            if words:
                record["words"] = words | record.get("words", {})
            if unit == "clock":
                unit = record.pop("unit")
            translated = record.get("words", {})
            self._ask_sides(
                [text for text in texts if text not in translated and not is_side(text, unit)], record
            )

    def _assume_mm(self, meaning: str, record: Mapping[str, Any]) -> None:
        """Name lengths as assumed mm, of which neither header nor cell states a unit."""
        columns = self._list_columns(record)
        if any(self._is_number(text) for n in columns for text in self._list_texts(n)):
            names = ", ".join(str(self._name(n)) for n in columns)
            self.draft.assumed[f"{meaning}.unit"] = f"mm: {names} states no unit"

    def _ask_sides(self, texts: Sequence[str], record: Mapping[str, Any]) -> None:
        """Ask where bevels face whose sides are not understood."""
        if not texts or "bevel_side" in self.draft.values:
            return
        orders: dict[int, list[tuple[str, ...]]] = {1: [("-1",), ("1",)], 2: [("1", "-1"), ("-1", "1")]}
        pairs = orders.get(len(texts), [("1",) * len(texts)])
        answers = {
            " ".join(f"{text}={side}" for text, side in zip(texts, sides, strict=True)): {
                "bevel_side.words": _to_toml(dict(zip(texts, sides, strict=True)))
            }
            for sides in pairs
        }
        if all(self.table.number(text) is not None for text in texts):
            answers = {"degrees": {"bevel_side.unit": "deg"}} | answers
        names = ", ".join(f"`{text}`" for text in texts[:MAX_FLAGS])
        self.draft.ask("bevel_side", self.where, answers, names=names, name=str(record["column"]))

    def _exclude_statistics(self, columns: Columns, names: set[str]) -> None:
        """Leave out rows that state a mean or a deviation in place of a needle."""
        statistics = sorted(name for name in names if find_meaning("statistic", name))
        if statistics and EXCLUDED not in columns:
            columns[EXCLUDED] = {
                "column": columns["needle"]["column"],
                "words": dict.fromkeys(statistics, EXCLUDED),
            }
            self.draft.assumed[EXCLUDED] = f"{', '.join(statistics)}: no needles"

    def _find_missing(self, entry: dict[str, Any]) -> None:
        """Propose which texts of coordinates mean that nothing was measured."""
        places, readings = (
            [n for key in keys for n in self._list_columns(entry["columns"].get(key, {}))]
            for keys in ("xyz", ("depth", "deflection"))
        )
        texts = {row[n] for row in self.table.rows for n in (*places, *readings)}
        words = sorted(text for text in texts if text.lower() in MISSING or text in CODES)
        cells = [[row[n] for n in places] for row in self.table.rows]
        partly = entry.get("layout") != "wide" and any(any(row) and not all(row) for row in cells)
        if words or partly:
            entry.setdefault("missing", words)
            entry.setdefault("if_missing", "leave_out")
            shown = ", ".join([*words, *(["blank"] if partly else [])])
            self.draft.assumed["if_missing"] = f"leave_out: points with {shown} were not measured"


def _read_column(text: str, parts: Sequence[str]) -> Header:
    """Return what the texts above a column mean: all together, else one of them."""
    read_headers = [read_header(header) for header in dict.fromkeys((text, *parts)) if header]
    best = next((header for header in read_headers if header.meaning or header.axis), Header(text))
    unit = best.unit or next((header.unit for header in read_headers if header.unit), "")
    return replace(best, text=text, unit=unit)


def _is_needle_material(text: str) -> bool:
    return find_meaning("value", text).endswith("GPa")


def _per(unit: str) -> str:
    """Return the unit of a curvature, whose header may state that of its length."""
    return f"1/{unit}" if unit and not unit.startswith("1/") else unit


def _to_toml(words: Mapping[str, str]) -> str:
    """Return an inline table of TOML, as `--set` takes it."""
    return f"{{{', '.join(f'{json.dumps(key)} = {json.dumps(value)}' for key, value in words.items())}}}"


def _increase(numbers: list[float]) -> bool:
    return len(numbers) >= MIN_READINGS and all(a < b for a, b in pairwise(numbers))


def _differ(numbers: list[float]) -> bool:
    return len({*numbers}) > 1
