"""Read the needles in files as a mapping states them: nothing is guessed."""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import zip_longest
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import as_error
from needlefit.datasets.formats import find_format
from needlefit.datasets.formats.markups import read_plane
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve, TipReading
from needlefit.datasets.importing.meanings import ATTRIBUTES, MEANINGS, SENSOR, VECTORS
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.importing.synonyms import find_meaning, read_quantity
from needlefit.datasets.importing.tables import (
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
from needlefit.schemas.mapping import MappingRecord, MeaningRecord, TableRecord

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
        return [n for n, cells in enumerate(self.read_cells("excluded")) if "excluded" not in cells]

    def where(self, n: int, meaning: str) -> str:
        """Return the place of the cell of a meaning in a row."""
        record = self.record.columns.get(meaning)
        if record is None or not record.column:
            return self.table.places[n]
        return f"{self.table.places[n]}, column {self.find(meaning, record.columns[0]) + 1}"

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

    def read_cells(self, meaning: str) -> list[list[str]]:
        """Return the texts of a meaning of each row: one of each column; none where it is not mapped."""
        return self._cells.get(meaning) or [[] for _ in self.table.rows]

    @cached_property
    def _cells(self) -> dict[str, list[list[str]]]:
        """The texts of all meanings that are mapped; empty where a cell was not measured."""
        return {
            meaning: [*self._list_cells(meaning, record)] for meaning, record in self.record.columns.items()
        }

    def _list_cells(self, meaning: str, record: MeaningRecord) -> Iterator[list[str]]:
        names = {"file": self.table.path.name.partition(".")[0], "sheet": self.table.name}
        columns = self.list_columns(meaning)
        missing, words = {*self.record.missing}, record.words
        for row in self.table.rows:
            texts = [row[m] for m in columns] or [names.get(record.source, str(record.value))]
            yield ["" if text in missing else words.get(text, text) for text in texts]

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
        if unit == "%" and meaning in ACROSS and (depth := self.read_cells("depth")[n]):
            percent = self.read_number("depth", n, depth[0]) / 100  # of the depth of the row
            return percent * self.record.columns[meaning].sign
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

    def read_number(self, meaning: str, n: int, text: str) -> float:
        """Return a cell in mm or 1/mm; DataError if it is no number."""
        if (value := self.table.number(text)) is None:
            missing = self.name_edit("missing", f'["{text[:20]}"]')
            missing = f"; or, if it was not measured: {missing} {self.name_edit('if_missing', 'leave_out')}"
            missing = missing if not any(map(str.isdigit, text)) else ""
            raise DataError(
                f"{meaning} is {text[:40]!r}",
                expected=f"a number with the decimal sign {self.table.decimal!r}",
                fix=f"write one number in each cell{missing}",
                where=self.where(n, meaning),
            )
        return value * self.read_factor(meaning, n)


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
    of_points = [mapped for mapped in tables if mapped.record.holds in ("shapes", "tips", "tracks")]
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
        surface = replace(surface, kind="solid" if surface.mesh.is_watertight else "sheet")
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
    cells = {axis: mapped.read_cells(axis) for axis in axes if axis in columns}
    rows = defaultdict[tuple[str, int], list[int]](list)
    names, is_wide = _read_names(mapped), mapped.record.layout == "wide"
    for n in mapped.kept_rows:
        rows[names[n], n * is_wide].append(n)
    for (name, _), numbers in rows.items():
        measured, missing = _list_measured(mapped, numbers, cells)
        if missing:
            left_out.append(f"{missing} of {name or mapped.table.name}")
        is_point = len(measured) == 1 and mapped.record.holds == "shapes"
        if is_point and (
            len(numbers) > 1 or len(rows) == len(mapped.kept_rows)
        ):  # cut short; or no shape at all
            raise DataError(
                f"{name or mapped.table.name} has one point: it is a tip, and no shape",
                expected="the points of each needle from the entry to the tip",
                fix=(
                    "complete its points; or, if the table holds tips alone: "
                    f"{mapped.name_edit('holds', 'tips')}"
                ),
                where=mapped.table.places[measured[0].row],
            )
        if measured:
            curve = _make_curve(mapped, name, measured, tuple(cells), is_deflection)
            yield replace(curve, holds="tips") if is_point else curve  # a tip beside shapes


def _read_names(mapped: MappedTable) -> list[str]:
    """Return the name of the needle of each row, as its cells are written."""
    record = mapped.record.columns.get("needle")
    names = ["-".join(filter(None, cells)) for cells in mapped.read_cells("needle")]
    if record is None or not record.pattern:
        return names
    matches = [re.fullmatch(record.pattern, name) for name in names]
    return [match[1] if match else name for match, name in zip(matches, names, strict=True)]


@dataclass(frozen=True)
class _Reading:
    """A point of a needle: its row, and its numbers in the order of the axes."""

    row: int
    values: Sequence[float]


def _list_measured(
    mapped: MappedTable, rows: Sequence[int], cells: Mapping[str, list[list[str]]]
) -> tuple[list[_Reading], int]:
    """Return the points whose coordinates were measured, and how many lack some of them."""
    columns = [mapped.list_columns(axis) for axis in cells]
    measured, missing = list[_Reading](), 0
    for n in rows:
        for k, texts in enumerate(
            zip_longest(*(cells_of_axis[n] for cells_of_axis in cells.values()), fillvalue="")
        ):
            raw = [
                mapped.table.rows[n][cells_of_axis[k]] for cells_of_axis in columns if k < len(cells_of_axis)
            ]
            if all(texts):
                numbers = [mapped.read_number(axis, n, text) for axis, text in zip(cells, texts, strict=True)]
                measured.append(_Reading(n, numbers))
            elif any(raw):
                if mapped.record.if_missing == "stop":
                    raise DataError(
                        f"a coordinate was not measured: {', '.join(raw)}",
                        expected=f"{', '.join(cells)} of each point",
                        fix=f"{mapped.name_edit('if_missing', 'leave_out')}, or correct the row",
                        where=mapped.table.places[n],
                    )
                missing += 1
    return measured, missing


def _make_curve(
    mapped: MappedTable, name: str, points: Sequence[_Reading], axes: Sequence[str], is_deflection: bool
) -> ImportedCurve:
    rows = [point.row for point in points]
    values = np.zeros((len(rows), 3))
    places = [axes.index(axis) if is_deflection else "xyz".index(axis) for axis in axes]
    values[:, places] = [point.values for point in points]
    lines = (
        None
        if mapped.table.lines is None
        else np.array([mapped.table.lines[n] for n in rows], dtype=np.int64)
    )
    stated = read_facts(mapped, rows)
    is_track = mapped.record.holds == "tracks" and "depth" in mapped.record.columns
    depths = (
        [mapped.read_number("depth", n, mapped.read_cells("depth")[n][0]) for n in rows] if is_track else []
    )
    if is_track or is_deflection:
        stated.pop("depth", None)
    return ImportedCurve(
        name or mapped.table.name,
        Points(mapped.table.path, values, lines, _read_sds(mapped, rows)),
        mapped.record.holds,
        stated,
        np.array(depths),
        str(mapped.record.columns["depth"].columns[0]) if is_track else "",
        is_deflection,
        _read_guide(mapped, rows),
        is_named=bool(name),
    )


def _read_sds(mapped: MappedTable, rows: Sequence[int]) -> Floats | None:
    """Return the standard deviation of each point (N,), mm; None if the table states one, or none of some."""
    if (record := mapped.record.columns.get("point_sd")) is None:
        return None
    texts = [mapped.read_cells("point_sd")[n][0] for n in rows]
    if record.divide_by_root is None and (len({*texts}) < 2 or not all(texts)):
        return None
    sds = np.array([mapped.read_number("point_sd", n, text) for n, text in zip(rows, texts, strict=True)])
    if record.divide_by_root is None:
        return sds
    column = mapped.find("point_sd", record.divide_by_root)
    return sds / np.sqrt([mapped.table.number(mapped.table.rows[n][column]) or 1.0 for n in rows])


def _read_guide(mapped: MappedTable, rows: Sequence[int]) -> Floats | None:
    """Return the places of the guide (N, 3), mm; NaN along axes of which no column is."""
    if (record := mapped.record.columns.get("guide")) is None:
        return None
    cells = mapped.read_cells("guide")
    axes = record.axes or ("yz" if len(cells[0]) < len("xyz") else "xyz")[: len(cells[0])]
    places = np.full((len(rows), 3), np.nan)
    for k, axis in enumerate(axes[: len(cells[0])]):
        places[:, "xyz".index(axis)] = [mapped.read_number("guide", n, cells[n][k]) for n in rows]
    return places


# ---- facts


def read_facts(mapped: MappedTable, rows: Sequence[int]) -> dict[str, Stated]:
    """Return what columns state once of the needle, the specimen or all in some rows.

    DataError if two cells of one column contradict each other.
    """
    stated: dict[str, Stated] = {}
    for meaning in ATTRIBUTES:
        if meaning not in mapped.record.columns:
            continue
        cells = mapped.read_cells(meaning)
        texts = {n: _join(meaning, cells[n]) for n in rows if any(cells[n])}
        if not texts:
            continue
        first = next(iter(texts))
        other = next((n for n, text in texts.items() if text != texts[first]), None)
        record = mapped.record.columns[meaning]
        if (other is not None and meaning in ("depth", "point_sd")) or record.divide_by_root is not None:
            continue  # those of each reading
        if other is not None:
            raise DataError(
                f"{meaning} is {texts[first][:40]!r} and {texts[other][:40]!r}",
                expected="one value",
                fix=(
                    "correct the cell; or, if another column names needles: "
                    f"{mapped.name_edit('columns.needle.column')}"
                ),
                where=mapped.where(other, meaning),
            )
        text = texts[first]
        if mapped.table.number(text) is not None and meaning not in ("medium", "specimen", "bevel_side"):
            text = f"{mapped.table.number(text):.10g}"  # with a decimal point
        stated[meaning] = Stated(text, mapped.read_unit(meaning, first), mapped.where(first, meaning))
    return stated


def _join(meaning: str, texts: Sequence[str]) -> str:
    return (", " if meaning in VECTORS else "; ").join(filter(None, texts))


def _add_rows(mapped: MappedTable, curves: list[ImportedCurve]) -> None:
    """Add to needles what the rows of a table state of them: facts, turns or curvatures."""
    if mapped.record.of == "all":
        for curve in curves:
            _add_facts(curve, read_facts(mapped, range(len(mapped.table.rows))))
        return
    by_specimen = mapped.record.of == "specimen"
    names = (
        [cells[0] if cells else "" for cells in mapped.read_cells("specimen")]
        if by_specimen
        else _read_names(mapped)
    )
    if mapped.record.holds == "curvatures":
        if "needle" not in mapped.record.columns:
            names = [mapped.table.name for _ in names]
        taken = {curve.name for curve in curves}
        for name in dict.fromkeys(filter(None, names)):
            if _match(name, taken) is None:
                points = Points(mapped.table.path, np.empty((0, 3)))
                curves.append(ImportedCurve(_make_name(name, taken), points, "curvatures"))
                taken.add(curves[-1].name)
    rows = defaultdict[str, list[int]](list)
    for n in mapped.kept_rows:
        name = names[n]
        if not name and any(any(mapped.read_cells(meaning)[n]) for meaning in mapped.record.columns):
            edit = mapped.name_edit("fill_down", '["HEADER"]')
            raise DataError(
                f"names no {mapped.record.of}",
                expected="a name in each row",
                fix=f"fill it in; or, if the cell above counts: {edit}",
                where=mapped.table.places[n],
            )
        rows[name].append(n)
    keys = {
        curve.name: curve.stated["specimen"].text
        if by_specimen and "specimen" in curve.stated
        else curve.name
        for curve in curves
    }
    matched = {name: [k for k, key in keys.items() if _match(name, [key])] for name in rows}
    _require_found(mapped, matched, keys)
    by_name = {curve.name: curve for curve in curves}
    for name, numbers in rows.items():
        for curve in (by_name[k] for k in matched[name]):
            if mapped.record.holds == "turns":
                curve.turns += [_read_turn(mapped, n) for n in numbers]
                continue
            if mapped.record.holds == "curvatures":
                curve.sensors += [_read_sensor(mapped, n) for n in numbers]
                curve.are_sensors_from_base |= "sensor_from_base" in mapped.record.columns
            facts = read_facts(mapped, numbers)
            if by_specimen:
                facts.pop("specimen", None)
            _add_facts(curve, facts)


def _add_facts(curve: ImportedCurve, facts: Mapping[str, Stated]) -> None:
    """Add facts to a needle; DataError if it has others."""
    for meaning, fact in facts.items():
        earlier = curve.stated.setdefault(meaning, fact)
        if earlier.text != fact.text:
            raise DataError(
                f"{meaning} of {curve.name} is {fact.text[:60]!r}, and {earlier.text[:60]!r} in "
                f"{earlier.where}",
                expected="one value",
                fix="correct one of the two",
                where=fact.where,
            )


def _read_turn(mapped: MappedTable, n: int) -> tuple[float, Stated]:
    depth = mapped.read_number("turn_depth", n, mapped.read_cells("turn_depth")[n][0])
    text = "".join(mapped.read_cells("bevel_side")[n])
    if not text:
        raise DataError(
            "nothing states where the bevel faces from this depth on",
            expected="bevel_side of each turn, as 90 deg",
            fix=f"fill in the cell; or {mapped.name_edit('columns.bevel_side.column')}",
            where=mapped.table.places[n],
        )
    return depth, Stated(text, mapped.read_unit("bevel_side", n), mapped.where(n, "bevel_side"))


def _read_sensor(mapped: MappedTable, n: int) -> Floats:
    """Return the place of a sensor, mm, its curvatures and their SD, 1/mm; NaN: no cell states the SD."""
    place = "sensor" if "sensor" in mapped.record.columns else "sensor_from_base"
    meanings: tuple[str, ...] = (place, *SENSOR[1:3])
    if lacking := [meaning for meaning in meanings if meaning not in mapped.record.columns]:
        raise DataError(
            f"of curvatures nothing states {', '.join(lacking)}",
            expected="the place of each sensor and its two curvatures",
            fix=" ".join(mapped.name_edit(f"columns.{meaning}.column") for meaning in lacking),
            where=mapped.table.places[n],
        )
    meanings += ("curvature_sd",) if "curvature_sd" in mapped.record.columns else ()
    values = [mapped.read_number(meaning, n, mapped.read_cells(meaning)[n][0]) for meaning in meanings]
    return np.array([*values, np.nan][: len(SENSOR)])


# ---- names


def _join_observations(curves: Sequence[ImportedCurve]) -> list[ImportedCurve]:
    """Return the needles; what has name and depth of a shape was measured of the same insertion.

    A tip stands beside the shape, a track is a further measurement of the same hole.
    """
    shapes = {curve.name: curve for curve in curves if curve.holds == "shapes" and curve.is_named}
    kept = list[ImportedCurve]()
    for curve in curves:
        shape, depths = shapes.get(curve.name), curve.line[:, 0] if curve.is_deflection else curve.depths
        depth = float(depths[-1]) if curve.holds != "shapes" and len(depths) else 0.0
        is_joined = depth and shape is not None and abs(shape.depth - depth) <= find_length_tolerance(depth)
        if is_joined and shape is not None and curve.holds == "tracks":
            shape.hole = curve.hole = curve.name
        if is_joined and shape is not None and curve.holds == "tips" and len(depths) == 1:
            sd = None if curve.points.sd is None else float(curve.points.sd[0])
            if "point_sd" in curve.stated:
                sd = curve.stated["point_sd"].to_number("point_sd", is_above=True)
            shape.tips.append(TipReading(curve.line[0, 1:], sd, curve.points.where()))
        else:
            kept.append(curve)
    return kept


def _name_curves(curves: list[ImportedCurve]) -> None:
    """Give each needle an id of its own."""
    taken = set[str]()
    counts = defaultdict[str, int](int)
    for curve in curves:
        counts[curve.name] += not curve.is_named
    numbers = defaultdict[str, int](int)
    for curve in curves:
        name = curve.name
        if not curve.is_named and counts[name] > 1:  # several blocks of one table
            numbers[name] += 1
            name = f"{name}-{numbers[name]}"
        curve.name = _make_name(name, taken)
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


def _match(name: str, candidates: Iterable[str]) -> str | None:
    """Return which of some names is the same: its id, or its number is (`1`, `1.0`, `01`)."""
    keys: tuple[Callable[[str], str], ...] = (_make_key, _make_number_key, _find_number)
    for make in keys if name.isdecimal() else keys[:2]:
        same = [candidate for candidate in candidates if make(candidate) == make(name)]
        if len(same) == 1:
            return same[0]
    return None


def _make_key(name: str) -> str:
    return make_id(name, name)[:MAX_NAME_CHARS].lower()


def _make_number_key(name: str) -> str:
    """Return a name without zeros that change no number: 1 for `1.0` and `01`, n1 for `n01`; not 1.10."""
    whole = re.sub(r"^(\d+)\.0+$", r"\1", _make_key(name))
    return re.sub(r"(?<![\d.])0+(?=\d)", "", whole)


def _find_number(name: str) -> str:
    """Return the number at the end of a name: 3 for `needle_03`."""
    match = re.search(r"0*(\d+)$", name)
    return match[1] if match else name


def _require_found(mapped: MappedTable, matched: Mapping[str, list[str]], keys: Mapping[str, str]) -> None:
    """DataError if a row is about no needle, or a needle without a row lacks what the others have."""
    strangers = [name for name, about in matched.items() if not about]
    about = {key for keys_ in matched.values() for key in keys_}
    without = [name for name in keys if name not in about]
    listed = join_names([*dict.fromkeys(keys.values())], MAX_LISTED_NAMES)
    if strangers or (without and mapped.record.holds == "facts"):
        problem = (
            f"no {mapped.record.of} is called {join_names(strangers, MAX_LISTED_NAMES)}"
            if strangers
            else (f"no row is about {join_names(without, MAX_LISTED_NAMES)}")
        )
        raise DataError(
            problem,
            expected=f"a row for each {mapped.record.of}: {listed}",
            fix=f"write the same names in both tables; or leave tables.{mapped.number} out of the mapping",
            where=mapped.table.where,
        )
