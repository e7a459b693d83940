"""Read the needles in files as a mapping states them: nothing is guessed."""

import json
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import as_error
from needlefit.datasets.formats import find_format
from needlefit.datasets.formats.markups import read_plane
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve, TipReading
from needlefit.datasets.importing.meanings import ATTRIBUTES, COORDINATES, MEANINGS, POINTS, SENSOR, VECTORS
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.importing.synonyms import find_meaning, read_quantity
from needlefit.datasets.importing.tables import (
    CODES,
    MISSING,
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    Table,
    lay_out,
    read_grids,
    read_structured,
)
from needlefit.datasets.layers import find_hole, find_length_tolerance, find_surface_faults
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.geometry.surfaces import (
    READ_SUFFIXES,
    Surface,
    make_sheet,
    read_coordinate_system,
    read_surface,
    transform_surface,
)
from needlefit.project.folders import sha256
from needlefit.project.locate import join_names, sort_by_similarity
from needlefit.project.units import UNITS_MM, UNITS_PER_MM
from needlefit.schemas.mapping import MappingRecord, TableRecord

MAX_CURVES = 2000  # largest number of needles, and of files: more is a wrong folder
MAX_NAME_CHARS = 60  # longest name of a needle (characters)
MAX_LISTED_NAMES = 4  # largest number of names in a message
ACROSS = ("deflection", "deflection_z", "y", "z")  #: meanings whose numbers may be percents of the depth
PLANE_SIZE_MM = 400.0  # edge of the sheet (mm) that stands for a plane
MIN_PLANE_PART = 0.05  # smallest extent of its points across the longest one, as a fraction of that
FACTORS = UNITS_MM | UNITS_PER_MM


@dataclass(frozen=True)
class MappedTable:
    """A table, the entry of the mapping that reads it, and the number of that entry."""

    table: Table
    record: TableRecord
    number: int  # from 1

    def name_edit(self, key: str, value: str = "HEADER") -> str:
        """Return the option that states a key of this table, as `columns.x.unit`."""
        return name_set(f"tables.{self.number}.{key}", value)

    @property
    def kept_rows(self) -> list[int]:
        """The rows that are not marked as excluded."""
        return [n for n, cells in enumerate(self.cells["excluded"]) if "excluded" not in cells]

    def where(self, n: int, meaning: str) -> str:
        """Return the place of the cell of a meaning in a row."""
        record = self.record.columns.get(meaning)
        if record is None or not record.column:
            return self.table.places[n]
        column, place = self.find(meaning, record.columns[0]) + 1, self.table.places[n]
        is_above = column > len(self.table.headers) - len(self.table.remarked)
        return f"{self.table.where}, above its rows" if is_above else f"{place}, column {column}"

    def find(self, meaning: str, name: str | int) -> int:
        """Return the column with a header or number; DataError with the nearest name if there is none."""
        column = self.table.find(name)
        if column is not None:
            return column
        headers = [text for text in self.table.headers if text]
        near = sort_by_similarity(str(name), headers)
        raise DataError(
            f"has no one column {name!r}, of which {meaning} is read",
            expected=f"one of {', '.join(headers)}, or a number from 1 to {len(self.table.headers)}",
            fix=self.name_edit(f"columns.{meaning}.column", near[0] if near else "1"),
            where=self.table.where,
        )

    def list_columns(self, meaning: str) -> list[int]:
        """Return the columns of a meaning; none where a value or a name stands in their place."""
        record = self.record.columns[meaning]
        return [self.find(meaning, name) for name in record.columns] if record.column else []

    @cached_property
    def cells(self) -> Mapping[str, list[list[str]]]:
        """The texts of each meaning in each row, one of each column; empty where it was not measured."""
        names = {"file": self.table.path.name.partition(".")[0], "sheet": self.table.sheet}
        cells = defaultdict[str, list[list[str]]](lambda: [[] for _ in self.table.rows])
        for meaning, record in self.record.columns.items():
            columns, value = self.list_columns(meaning), names.get(record.source, str(record.value))
            is_place = meaning in COORDINATES and self.record.holds in POINTS
            cells[meaning] = [
                [
                    ""
                    if text in self.record.missing or (is_place and _is_missing(text))
                    else record.words.get(text, text)
                    for text in [row[m] for m in columns] or [value]
                ]
                for row in self.table.rows
            ]
        return cells

    def read_unit(self, meaning: str, n: int) -> str:
        """Return the unit of a row, or of all; empty: that of the meaning."""
        record = self.record.columns[meaning]
        if record.unit_column is None:
            return record.unit
        text = self.table.rows[n][self.find(meaning, record.unit_column)]
        return find_meaning("unit", text) or text

    def read_factor(self, meaning: str, n: int) -> float:
        """Return by what numbers are multiplied to be in mm or 1/mm."""
        usual = MEANINGS[meaning].unit
        unit = self.read_unit(meaning, n) or usual
        if unit == "%" and meaning in ACROSS and self.cells["depth"][n]:  # of the depth of the row
            return self.read_number("depth", n) / 100 * self.record.columns[meaning].sign
        quantity = (1.0, unit) if unit in FACTORS else read_quantity(unit)
        number, plain = quantity or (1.0, unit)  # `0.07 mm` of a pixel
        if plain not in FACTORS or plain.startswith("1/") != usual.startswith("1/"):
            known_units = ", ".join(UNITS_PER_MM if usual.startswith("1/") else UNITS_MM)
            raise DataError(
                f"the unit of {meaning} is {unit!r}",
                expected=f"{known_units}, or the length of a step: 0.07 mm",
                fix=self.name_edit(f"columns.{meaning}.unit", usual),
                where=self.where(n, meaning),
            )
        return number * FACTORS[plain] * self.record.columns[meaning].sign

    def read_number(self, meaning: str, n: int, k: int = 0) -> float:
        """Return a cell of a row, that of the column `k`, in mm or 1/mm; DataError if it is no number."""
        text = self.cells[meaning][n][k]
        if (value := self.table.number(text)) is None:
            fix = "write one number in each cell"
            if not any(map(str.isdigit, text)):
                missing = self.name_edit("missing", f'["{text[:20]}"]')
                fix += f"; or, if it was not measured: {missing}"
            raise DataError(
                f"{meaning} is {text[:40]!r}",
                expected=f"a number with the decimal sign {self.table.decimal!r}",
                fix=fix,
                where=self.where(n, meaning),
            )
        return value * self.read_factor(meaning, n)

    def read_numbers(self, meaning: str, rows: Iterable[int], k: int = 0) -> Floats:
        """Return the cells of rows, those of the column `k`, in mm or 1/mm."""
        return np.array([self.read_number(meaning, n, k) for n in rows], dtype=np.float64)


def _is_missing(text: str) -> bool:
    """Whether a cell states that a coordinate was not measured."""
    return text in CODES or text.lower() in MISSING


def read_mapped(mapping: MappingRecord, paths: Sequence[Path], where: str) -> ImportContent:
    """Return the needles in files, as their mapping reads them.

    `where`: the file of the mapping, for messages. DataError if a file of the mapping is not there, a column
    is not there, a cell is not understood, or a needle is not found in a table that states facts of needles.
    """
    content = ImportContent([], _read_surfaces(mapping, paths), {path.name: sha256(path) for path in paths})
    tables = [*list_tables(mapping, paths, where)]
    left_out = list[str]()
    content.curves[:] = read_curves(tables, left_out)
    for mapped in tables:
        if mapped.record.holds in ("curvatures", "turns", "facts"):
            _add_rows(mapped, content.curves)
    unwanted = {name.strip() for name in mapping.values.get("leave_out", "").split(",")} - {""}
    known = {name for curve in content.curves for name in (curve.name, curve.given)}
    if missing := unwanted - known:
        raise DataError(
            f"no needle is called {join_names(sorted(missing), MAX_LISTED_NAMES)}, to be left out",
            expected=join_names(sorted(known), MAX_LISTED_NAMES),
            fix=f"correct {name_set('leave_out')}",
            where=where,
        )
    content.curves[:] = [curve for curve in content.curves if not unwanted & {curve.name, curve.given}]
    if not content.curves:
        raise DataError(
            "holds no needle",
            expected='a table with holds = "shapes", "tips", "tracks" or "curvatures"',
            fix="correct the mapping",
            where=where,
        )
    if len(content.curves) > MAX_CURVES:
        raise DataError(
            f"holds {len(content.curves)} needles",
            expected=f"at most {MAX_CURVES}",
            fix="correct the column of needle",
            where=where,
        )
    return replace(content, left_out=left_out)


def read_curves(tables: Sequence[MappedTable], left_out: list[str]) -> list[ImportedCurve]:
    """Return the needles of tables of points; `left_out` gets the counts of points without a coordinate."""
    of_points = [mapped for mapped in tables if mapped.record.holds in POINTS]
    curves = _join_observations([curve for mapped in of_points for curve in _read_points(mapped, left_out)])
    _name_curves(curves)
    return curves


def list_tables(mapping: MappingRecord, paths: Sequence[Path], where: str) -> Iterator[MappedTable]:
    """Yield each table that the mapping reads; DataError if one of its files or sheets is not there."""
    names = [path.name for path in paths]
    for number, record in enumerate(mapping.tables, 1):
        matching = [
            path for path in paths if any(fnmatchcase(path.name, pattern) for pattern in record.files)
        ]
        if not matching:
            near = sort_by_similarity(record.files[0], names)
            raise DataError(
                f"tables.{number} reads {join_names(record.files, 3)}, and no file has this name",
                expected=join_names(names, MAX_LISTED_NAMES),
                fix=name_set(f"tables.{number}.files", f'["{near[0] if near else "*"}"]'),
                where=where,
            )
        count = 0
        for path in matching:
            for table in _read_tables(path, record):
                count += 1
                yield MappedTable(table, record, number)
        if not count:
            raise DataError(
                f"has no sheet {record.sheet!r}",
                expected="a sheet of this name",
                fix=name_set(f"tables.{number}.sheet", "*"),
                where=f"{matching[0]}",
            )


def _read_tables(path: Path, record: TableRecord) -> list[Table]:
    if path.suffix.lower() not in (*TEXT_SUFFIXES, *SHEET_SUFFIXES):
        return [read_structured(path)[0]]
    grids = [
        grid for grid in read_grids(path, record) if not grid.sheet or fnmatchcase(grid.sheet, record.sheet)
    ]
    return [lay_out(grid, record) for grid in grids]


def _read_surfaces(mapping: MappingRecord, paths: Sequence[Path]) -> list[Surface]:
    """Return the surfaces in their order; DataError of one that cannot part layers."""
    surfaces = list[Surface]()
    for name in mapping.surfaces:
        path = next((path for path in paths if path.name == name), None)
        form = None if path is None else find_format(path)
        if path is not None and form is not None and form.name == "markups":
            surfaces.append(_fit_plane(path))
            continue
        if path is None or path.suffix.lower() not in READ_SUFFIXES:
            raise DataError(
                f"there is no surface {name!r} among the files",
                expected=f"a file of {', '.join(READ_SUFFIXES)}, or points or a plane of Slicer",
                fix="name it, or correct `surfaces` of the mapping",
            )
        surface = read_surface(path, "sheet", 2)
        if read_coordinate_system(path) == "RAS":
            surface = transform_surface(surface, RAS_TO_LPS)
        surface = replace(surface, kind="solid" if surface.is_closed else "sheet")
        faults = list(find_surface_faults(surface, path))
        if surface.kind == "sheet" and not faults:
            faults = list(find_hole(surface, path, "close the hole, or save the sheet alone"))
        if faults:
            raise as_error(faults, path)
        taken = {surface.name for surface in surfaces}
        surfaces.append(replace(surface, name=make_unique(surface.name[:MAX_NAME_CHARS], taken)))
    return surfaces


def _fit_plane(path: Path) -> Surface:
    """Return the plane through the points of a markup; DataError if they lie on a line."""
    points = read_plane(path).values
    center = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - center)
    if len(points) < len("xyz") or sizes[1] < MIN_PLANE_PART * sizes[0]:
        raise DataError(
            "its points lie on one line, which defines no plane",
            expected="three points or more, spread over the boundary",
            fix=f"place points beside the line; or leave it out and state {name_set('boundaries', 'DEPTH')}",
            where=path,
        )
    return make_sheet(path.name.partition(".")[0], center, axes[2], PLANE_SIZE_MM, 2)


# ---- points


def _read_points(mapped: MappedTable, left_out: list[str]) -> Iterator[ImportedCurve]:
    """Yield the needles of a table of points, each with its points in their order."""
    columns = mapped.record.columns
    is_deflection = "deflection" in columns or "x" not in columns
    axes: Sequence[str] = ("depth", "y", "z") if is_deflection else ("x", "y", "z")
    axes = ("depth", "deflection", "deflection_z") if "deflection" in columns else axes
    if lacking := [axis for axis in axes[:2] if axis not in columns]:
        raise DataError(
            f"nothing states {' and '.join(lacking)} of its points",
            expected="x and y; or depth and deflection",
            fix=" ".join(mapped.name_edit(f"columns.{axis}.column") for axis in lacking),
            where=mapped.table.where,
        )
    axes = [axis for axis in axes if axis in columns]
    rows = defaultdict[tuple[str, int], list[int]](list)
    names, is_wide = _read_names(mapped), mapped.record.layout == "wide"
    for n in mapped.kept_rows:
        rows[names[n], n * is_wide].append(n)
    for (name, _), numbers in rows.items():
        points, missing = _list_measured(mapped, numbers, axes)
        if missing:
            left_out.append(f"{missing} of {name or mapped.table.name}")
        is_point = len(points) == 1 and mapped.record.holds == "shapes"
        if is_point and (
            len(numbers) > 1 or len(rows) == len(mapped.kept_rows)
        ):  # cut short; or no shape at all
            raise DataError(
                f"{name or mapped.table.name} has one point: it is a tip, and no shape",
                expected="the points of each needle from the entry to the tip",
                fix=f"complete its points; or, of a table of tips: {mapped.name_edit('holds', 'tips')}",
                where=mapped.table.places[points[0][0]],
            )
        if points:
            curve = _make_curve(mapped, name, points, axes, is_deflection)
            yield replace(curve, holds="tips") if is_point else curve  # a tip beside shapes


def _read_names(mapped: MappedTable) -> list[str]:
    """Return the name of the needle of each row, as its cells are written."""
    record = mapped.record.columns.get("needle")
    names = ["-".join(filter(None, cells)) for cells in mapped.cells["needle"]]
    if record is None or not record.pattern:
        return names
    return [match[1] if (match := re.fullmatch(record.pattern, name)) else name for name in names]


def _list_measured(
    mapped: MappedTable, rows: Sequence[int], axes: Sequence[str]
) -> tuple[list[tuple[int, list[float]]], int]:
    """Return row and numbers of the points that were measured, and how many lack a coordinate."""
    columns = [mapped.list_columns(axis) for axis in axes]
    measured, missing = list[tuple[int, list[float]]](), 0
    for n in rows:
        cells = [mapped.cells[axis][n] for axis in axes]
        for k in range(max(map(len, cells))):
            raw = [mapped.table.rows[n][places[k]] for places in columns if k < len(places)]
            if all(k < len(texts) and texts[k] for texts in cells):
                measured.append((n, [mapped.read_number(axis, n, k) for axis in axes]))
            else:
                missing += any(raw) or mapped.record.holds == "tracks"
    return measured, missing


def _make_curve(
    mapped: MappedTable,
    name: str,
    points: Sequence[tuple[int, list[float]]],
    axes: Sequence[str],
    is_deflection: bool,
) -> ImportedCurve:
    rows, columns = [row for row, _ in points], mapped.record.columns
    values = np.zeros((len(rows), 3))
    places = [axes.index(axis) if is_deflection else "xyz".index(axis) for axis in axes]
    values[:, places] = [numbers for _, numbers in points]
    lines = mapped.table.lines
    stated = read_facts(mapped, rows)
    is_track = mapped.record.holds == "tracks" and "depth" in columns
    if is_track or is_deflection:
        stated.pop("depth", None)
    return ImportedCurve(
        name or mapped.table.name,
        Points(
            mapped.table.path,
            values,
            None if lines is None else np.array([lines[n] for n in rows], dtype=np.int64),
            _read_sds(mapped, rows),
        ),
        mapped.record.holds,
        stated,
        mapped.read_numbers("depth", rows if is_track else ()),
        str(columns["depth"].columns[0]) if is_track else "",
        is_deflection,
        _read_guide(mapped, rows),
        is_named=bool(name),
    )


def _read_sds(mapped: MappedTable, rows: Sequence[int]) -> Floats | None:
    """Return the standard deviation of each point (N,), mm; None if the table states one, or none of some."""
    if (record := mapped.record.columns.get("point_sd")) is None:
        return None
    texts = [mapped.cells["point_sd"][n][0] for n in rows]
    if record.divide_by_root is None and (len({*texts}) < 2 or not all(texts)):
        return None
    sds = mapped.read_numbers("point_sd", rows)
    if record.divide_by_root is None:
        return sds
    column = mapped.find("point_sd", record.divide_by_root)
    return sds / np.sqrt([mapped.table.number(mapped.table.rows[n][column]) or 1.0 for n in rows])


def _read_guide(mapped: MappedTable, rows: Sequence[int]) -> Floats | None:
    """Return the places of the guide (N, 3), mm; NaN along axes of which no column is."""
    if (record := mapped.record.columns.get("guide")) is None:
        return None
    count = len(mapped.cells["guide"][0])
    axes = record.axes or ("yz" if count < len("xyz") else "xyz")
    places = np.full((len(rows), 3), np.nan)
    for k, axis in enumerate(axes[:count]):
        places[:, "xyz".index(axis)] = mapped.read_numbers("guide", rows, k)
    return places


# ---- facts


def read_facts(mapped: MappedTable, rows: Sequence[int]) -> dict[str, Stated]:
    """Return what columns state once of the needle, the specimen or all in some rows.

    DataError if two cells of one column contradict each other.
    """
    stated: dict[str, Stated] = {}
    for meaning in filter(mapped.record.columns.__contains__, ATTRIBUTES):
        sign = ", " if meaning in VECTORS else "; "
        cells = mapped.cells[meaning]
        texts = {n: sign.join(filter(None, cells[n])) for n in rows if any(cells[n])}
        differ = len({*texts.values()}) > 1
        is_of_readings = differ and meaning in ("depth", "point_sd")
        if not texts or is_of_readings or mapped.record.columns[meaning].divide_by_root is not None:
            continue
        first, text = next(iter(texts.items()))
        if differ and meaning in ("boundaries", "thickness") and mapped.record.of == "all":
            text = "; ".join(texts.values())  # a row for each layer
        elif differ:
            other = next(n for n in texts if texts[n] != text)
            needles = mapped.name_edit("columns.needle.column")
            raise DataError(
                f"{meaning} is {text[:40]!r} and {texts[other][:40]!r}",
                expected="one value",
                fix=f"correct the cell; or, if another column names needles: {needles}",
                where=mapped.where(other, meaning),
            )
        value = mapped.table.number(text)
        if value is not None and meaning not in ("medium", "specimen", "bevel_side"):
            text = f"{value:.10g}"  # with a decimal point
        stated[meaning] = Stated(text, mapped.read_unit(meaning, first), mapped.where(first, meaning))
    if "thickness" in stated:
        stated["boundaries"] = stated.pop("thickness").add_up()
    return stated


def _add_rows(mapped: MappedTable, curves: list[ImportedCurve]) -> None:
    """Add to needles what the rows of a table state of them: facts, turns or curvatures."""
    record, table = mapped.record, mapped.table
    if record.of == "all":
        for curve in curves:
            _add_facts(curve, read_facts(mapped, range(len(table.rows))))
        return
    by_specimen = record.of == "specimen"
    names = ["".join(cells) for cells in mapped.cells["specimen"]] if by_specimen else _read_names(mapped)
    if record.holds == "curvatures":
        if "needle" not in record.columns:
            names = [table.name for _ in names]
        taken = {curve.name for curve in curves}
        for name in dict.fromkeys(filter(None, names)):
            if not any(_is_same(name, other) for other in taken):
                points = Points(table.path, np.empty((0, 3)))
                curves.append(ImportedCurve(_make_name(name, taken), points, "curvatures"))
                taken.add(curves[-1].name)
    rows = defaultdict[str, list[int]](list)
    for n in mapped.kept_rows:
        if not names[n] and any(any(mapped.cells[meaning][n]) for meaning in record.columns):
            edit = mapped.name_edit("fill_down", '["HEADER"]')
            raise DataError(
                f"names no {record.of}",
                expected="a name in each row",
                fix=f"fill it in; or, if the cell above counts: {edit}",
                where=table.places[n],
            )
        rows[names[n]].append(n)
    keys = [
        curve.stated["specimen"].text
        if by_specimen and "specimen" in curve.stated
        else curve.name
        if any(_is_same(name, curve.name) for name in rows)
        else curve.given or curve.name
        for curve in curves
    ]
    pairs = {
        name: [curve for curve, key in zip(curves, keys, strict=True) if _is_same(name, key)] for name in rows
    }
    paired_ids = {id(curve) for paired in pairs.values() for curve in paired}
    free = {key: curve for curve, key in zip(curves, keys, strict=True) if id(curve) not in paired_ids}
    strangers = [name for name, paired in pairs.items() if not paired]
    pairs |= {name: [free[key]] for name, key in _match_endings(strangers, free).items()}
    _require_found(mapped, pairs, curves, keys)
    for name, numbers in rows.items():
        for curve in pairs[name]:
            if record.holds == "turns":
                curve.turns += [_read_turn(mapped, n) for n in numbers]
                continue
            if record.holds == "curvatures":
                curve.sensors += [_read_sensor(mapped, n) for n in numbers]
                curve.are_sensors_from_base |= "sensor_from_base" in record.columns
            facts = read_facts(mapped, numbers)
            if by_specimen:
                facts.pop("specimen", None)
            _add_facts(curve, facts)


_WORD = re.compile(r"[^\W\d_]{3,}|.*[-_ .]")  # before the name of a needle: `needle_`, `needle`


def _match_endings(names: Collection[str], keys: Collection[str]) -> dict[str, str]:
    """Return the key of each name, if all names differ from keys by one word before them: `needle_A1`, `A1`.

    The word stands in all names, or in all keys.
    """
    for name, key in product(names, keys):
        longer, shorter = sorted((name, key), key=len, reverse=True)
        word = longer.removesuffix(shorter)
        found = {
            one: other for one, other in product(names, keys) if {word + one, word + other} & {one, other}
        }
        if _WORD.fullmatch(word) and len(found) == len(names) == len({*found.values()}):
            return found
    return {}


def _add_facts(curve: ImportedCurve, facts: Mapping[str, Stated]) -> None:
    """Add facts to a needle; DataError if it has others."""
    for meaning, fact in facts.items():
        earlier = curve.stated.setdefault(meaning, fact)
        if earlier.text != fact.text:
            raise DataError(
                f"{meaning} of {curve.name} is {fact.text[:60]!r}, in {earlier.where} {earlier.text[:60]!r}",
                expected="one value",
                fix="correct one of the two",
                where=fact.where,
            )


def _read_turn(mapped: MappedTable, n: int) -> tuple[float, Stated]:
    text = "".join(mapped.cells["bevel_side"][n])
    if not text:
        raise DataError(
            "nothing states where the bevel faces from this depth on",
            expected="bevel_side of each turn, as 90 deg",
            fix=f"fill in the cell; or {mapped.name_edit('columns.bevel_side.column')}",
            where=mapped.table.places[n],
        )
    cell = Stated(text, mapped.read_unit("bevel_side", n), mapped.where(n, "bevel_side"))
    return mapped.read_number("turn_depth", n), cell


def _read_sensor(mapped: MappedTable, n: int) -> Floats:
    """Return the place of a sensor, mm, its curvatures and their SD, 1/mm; NaN: no cell states the SD."""
    columns = mapped.record.columns
    meanings = ("sensor" if "sensor" in columns else "sensor_from_base", *SENSOR[1:3])
    if lacking := [meaning for meaning in meanings if meaning not in columns]:
        raise DataError(
            f"of curvatures nothing states {', '.join(lacking)}",
            expected="the place of each sensor and its two curvatures",
            fix=" ".join(mapped.name_edit(f"columns.{meaning}.column") for meaning in lacking),
            where=mapped.table.places[n],
        )
    sd = mapped.read_number("curvature_sd", n) if "curvature_sd" in columns else np.nan
    return np.array([*(mapped.read_number(meaning, n) for meaning in meanings), sd])


# ---- names


def _join_observations(curves: Sequence[ImportedCurve]) -> list[ImportedCurve]:
    """Return the needles; what has name and depth of a shape was measured of the same insertion.

    Tips stand beside the shape, a track is a further measurement of the same hole.
    """
    shapes = {curve.name: curve for curve in curves if curve.holds == "shapes" and curve.is_named}
    kept = list[ImportedCurve]()
    for curve in curves:
        shape, depths = shapes.get(curve.name), curve.line[:, 0] if curve.is_deflection else curve.depths
        if shape is None or curve.holds == "shapes" or not len(depths):
            kept.append(curve)
            continue
        at_end = np.abs(shape.depth - depths) <= find_length_tolerance(float(depths[-1]))
        is_same = at_end[-1]
        if curve.holds == "tips":
            is_same = at_end.any()
            for n in np.flatnonzero(at_end):
                sd = None if curve.points.sd is None else float(curve.points.sd[n])
                if "point_sd" in curve.stated:
                    sd = curve.stated["point_sd"].to_number("point_sd", is_above=True)
                shape.tips.append(TipReading(curve.line[n, 1:], sd, curve.points.where(int(n))))
            curve = replace(curve, points=curve.points.part(np.flatnonzero(~at_end)))
        if is_same:
            shape.hole = curve.hole = curve.name
        if len(curve.line):
            kept.append(curve)
    return kept


def _name_curves(curves: list[ImportedCurve]) -> None:
    """Give each needle an id of its own; several blocks of one table are numbered."""
    taken, blocks = set[str](), Counter(curve.name for curve in curves if not curve.is_named)
    numbers = Counter[str]()
    for curve in curves:
        name = curve.name
        if not curve.is_named and blocks[name] > 1:
            numbers[name] += 1
            name = f"{name}-{numbers[name]}"
        curve.given, curve.name = name, _make_name(name, taken)
        taken.add(curve.name)


def _make_name(text: str, taken: Iterable[str]) -> str:
    """Return the id of a needle that a text names, which is none of those that are taken."""
    return make_unique(make_id(text, "curve")[:MAX_NAME_CHARS], taken)


def make_unique(name: str, taken: Iterable[str]) -> str:
    """Return a name, numbered from 2 where it is taken."""
    names, count, unique = {*taken}, 1, name
    while unique in names:
        count += 1
        unique = f"{name}-{count}"
    return unique


def _is_same(name: str, other: str) -> bool:
    """Whether two names have the same id, or number (`1`, `1.0`, `01`): 3 is `needle_03`, too."""
    is_number = name.isdecimal() and _find_number(name) == _find_number(other)
    return is_number or _make_key(name) == _make_key(other)


def _make_key(name: str) -> str:
    """Return a name without zeros that change no number: 1 for `1.0` and `01`, n1 for `n01`; not 1.10."""
    whole = re.sub(r"^(\d+)\.0+$", r"\1", make_id(name, name)[:MAX_NAME_CHARS].lower())
    return re.sub(r"(?<![\d.])0+(?=\d)", "", whole)


def _find_number(name: str) -> str:
    """Return the number at the end of a name: 3 for `needle_03`."""
    match = re.search(r"0*(\d+)$", name)
    return match[1] if match else name


def _require_found(
    mapped: MappedTable,
    pairs: Mapping[str, Sequence[ImportedCurve]],
    curves: Sequence[ImportedCurve],
    keys: Sequence[str],
) -> None:
    """DataError if a row is about no needle, or a needle without a row lacks what the others have.

    `pairs`: the needles of each name in the rows; `keys`: what each needle is called there.
    """
    strangers = [name for name, about in pairs.items() if not about]
    about = {curve.name for paired in pairs.values() for curve in paired}
    without = [curve.name for curve in curves if curve.name not in about]
    kind, problem = mapped.record.of, f"no row is about {join_names(without, MAX_LISTED_NAMES)}"
    called = dict(zip((curve.name for curve in curves), keys, strict=True))
    # those first that no row is about
    named = [called[name] for name in sorted(called, key=about.__contains__)]
    unused = json.dumps([mapped.table.sheet or mapped.table.path.name])
    if strangers or (without and mapped.record.holds == "facts"):
        if strangers:
            problem = f"no {kind} is called {join_names(strangers, MAX_LISTED_NAMES)}"
        raise DataError(
            problem,
            expected=f"a row for each {kind}: {join_names(named, MAX_LISTED_NAMES)}",
            fix=f"write the same names in both tables; or leave this one out: {name_set('unused', unused)}",
            where=mapped.table.where,
        )
