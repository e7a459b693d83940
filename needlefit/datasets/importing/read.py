"""Read the needles in files as a mapping states them: nothing is guessed."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import count
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import as_error
from needlefit.datasets.formats import find_format
from needlefit.datasets.formats.markups import read_plane
from needlefit.datasets.importing.kinds import KINDS, ImportedCurve, list_kinds
from needlefit.datasets.importing.layout import lay_out
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import ATTRIBUTES, MEANINGS
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.importing.tables import (
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    Table,
    name_files,
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
from needlefit.grouping import group_values
from needlefit.project.folders import sha256
from needlefit.project.locate import join_names, sort_by_similarity
from needlefit.schemas.mapping import MappingRecord, TableRecord

MAX_CURVES = 2000  # largest number of needles, and of files: more is a wrong folder
MAX_LISTED_NAMES = 4  # largest number of names in a message
MAX_NAME_CHARS = 60  # longest name of a needle (characters)
PLANE_SIZE_MM = 400.0  # edge of the sheet (mm) that stands for a plane
MIN_PLANE_PART = 0.05  # smallest extent of its points across the longest one, as a fraction of that


@dataclass(frozen=True)
class ImportContent:
    """What the files of an import hold, as the mapping reads them."""

    curves: list[ImportedCurve]
    surfaces: list[Surface]  # between the layers, in their order
    files: Mapping[str, str]  # SHA-256 of each file, by name
    left_out: Sequence[str]  # points without a measured coordinate, counted for each table
    tables: Sequence[MappedTable]  # as they were read


def read_mapped(mapping: MappingRecord, paths: Sequence[Path], where: str) -> ImportContent:
    """Return the needles in files, as their mapping reads them.

    `where`: the file of the mapping, for messages. DataError if a file of the mapping is not there, a column
    is not there, a cell is not understood, or a needle is not found in a table that states facts of needles.
    """
    surfaces, left_out = _read_surfaces(mapping, paths), list[str]()
    tables = [*list_tables(mapping, paths, where)]
    curves = read_curves(tables, left_out)
    for mapped in tables:
        if not mapped.has_points:
            _add_rows(mapped, curves)
    if timed := [curve for curve in curves if curve.is_deflection and len(curve.times)]:
        raise DataError(
            f"nothing states the depths of the readings of {timed[0].name}",
            expected="a column `depth`, or a table of times and depths",
            fix="name that table, too",
            where=timed[0].points.where(),
        )
    unwanted = split_names(mapping.values.get("leave_out", ""))
    names = {name for curve in curves for name in (curve.name, curve.given)}
    missing = (unwanted | mapping.needles.keys()) - names
    missing = missing.union(*mapping.needles.values()) - {*ATTRIBUTES}
    if missing:
        raise DataError(
            f"no needle or meaning is called {join_names(sorted(missing), MAX_LISTED_NAMES)}",
            expected=join_names(sorted(names), MAX_LISTED_NAMES),
            fix="correct the name",
            where=where,
        )
    for name, facts in mapping.needles.items():
        cells = {key: Stated(key, text, "", f"key needles.{name}.{key}") for key, text in facts.items()}
        for curve in curves:
            if name in (curve.name, curve.given):
                curve.stated |= cells
    curves = [curve for curve in curves if not unwanted & {curve.name, curve.given}]
    if not 0 < len(curves) <= MAX_CURVES:
        raise DataError(
            f"holds {len(curves)} needles",
            expected=f"1 to {MAX_CURVES}, in {', '.join(kind.name for kind in list_kinds() if kind.placer)}",
            fix="correct the mapping: what its tables hold, and the column of needle",
            where=where,
        )
    files = {name: sha256(path) for path, name in name_files(paths).items()}
    return ImportContent(curves, surfaces, files, left_out, tables)


def read_curves(tables: Sequence[MappedTable], left_out: list[str]) -> list[ImportedCurve]:
    """Return the needles of tables of points; `left_out` gets the counts of points without a coordinate."""
    of_points = [mapped for mapped in tables if mapped.has_points]
    needles = [needle for mapped in of_points for needle in _read_points(mapped, left_out)]
    _join_observations(needles)
    return _name_curves([needle for needle in needles if needle])


def _read_surfaces(mapping: MappingRecord, paths: Sequence[Path]) -> list[Surface]:
    """Return the surfaces in their order; DataError of one that cannot part layers."""
    surfaces = list[Surface]()
    for name in mapping.surfaces:
        path = next((path for path in paths if path.absolute().match(name)), Path())
        if (form := find_format(path)) is not None and form.name == "markups":
            surfaces.append(_fit_plane(path))
            continue
        if path.suffix.lower() not in READ_SUFFIXES:
            raise DataError(
                f"there is no surface {name!r} among the files",
                expected=f"a file of {', '.join(READ_SUFFIXES)}, or points or a plane of Slicer",
                fix="name it, or correct `surfaces` of the mapping",
            )
        surface = read_surface(path, "sheet", 2)
        if read_coordinate_system(path) == "RAS":
            surface = transform_surface(surface, RAS_TO_LPS)
        surface = replace(surface, kind="solid" if surface.is_closed else "sheet")
        faults = [*find_surface_faults(surface, path)]
        if surface.kind == "sheet" and not faults:
            faults = [*find_hole(surface, path, "close the hole, or save the sheet alone")]
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


# ---- tables


def list_tables(mapping: MappingRecord, paths: Sequence[Path], where: str) -> Iterator[MappedTable]:
    """Yield each table that the mapping reads; DataError if one of its files or sheets is not there."""
    names = name_files(paths)
    for number, record in enumerate(mapping.tables, 1):
        matching = [path for path in paths if any(map(path.absolute().match, record.files))]
        if not matching:
            near = sort_by_similarity(record.files[0], [*names.values()])
            raise DataError(
                f"tables.{number} reads {join_names(record.files, 3)}, and no file has this name",
                expected=join_names([*names.values()], MAX_LISTED_NAMES),
                fix=name_set(f"tables.{number}.files", f'["{near[0] if near else "*"}"]'),
                where=where,
            )
        tables = [
            replace(table, file=names[path]) for path in matching for table in _read_tables(path, record)
        ]
        has_points = KINDS[record.holds].has_points
        if unknown := [meaning for meaning in record.columns if meaning not in MEANINGS]:
            raise DataError(
                f"tables.{number} states columns of {join_names(unknown, MAX_LISTED_NAMES)}",
                expected="meanings: needlefit explain mapping",
                fix=f"did you mean {sort_by_similarity(unknown[0], [*MEANINGS])[0]}",
                where=where,
            )
        for table in tables:
            yield MappedTable(**vars(table), record=record, entry=number, has_points=has_points)
        if not tables:
            raise DataError(
                f"has no sheet {record.sheet!r}",
                expected="a sheet of this name",
                fix=name_set(f"tables.{number}.sheet", "*"),
                where=f"{matching[0]}",
            )


def _read_tables(path: Path, record: TableRecord) -> list[Table]:
    if path.suffix.lower() not in (*TEXT_SUFFIXES, *SHEET_SUFFIXES):
        return [read_structured(path)]
    grids = [
        grid for grid in read_grids(path, record) if not grid.sheet or fnmatchcase(grid.sheet, record.sheet)
    ]
    return [lay_out(grid, record) for grid in grids]


# ---- points


def _read_points(mapped: MappedTable, left_out: list[str]) -> Iterator[list[ImportedCurve]]:
    """Yield the insertions of each needle of a table, with the points that were measured, in their order."""
    columns, kind = mapped.record.columns, KINDS[mapped.record.holds]
    is_angle = "tangent" in columns and "x" not in columns
    is_deflection = not is_angle and ("deflection" in columns or "x" not in columns)
    across = ("deflection", "deflection_z") if "deflection" in columns else ("y", "z")
    is_timed = "depth" not in columns and "time" in columns and (is_deflection or kind.is_track)
    along = "time" if is_timed and is_deflection else "depth" if is_deflection else "x"
    axes = ["arc", "tangent"] if is_angle else [along, *across]
    mapped.require(*axes[:2])
    axes = [axis for axis in axes if axis in columns]
    names, are_needles = mapped.names, kind.has_stops and "needle" not in columns
    are_needles |= mapped.record.layout == "wide"
    groups = group_values(((names[n], n * are_needles), n) for n in mapped.kept_rows)
    for (name, _), numbers in groups.items():
        rows, points, missing, given = list[int](), list[list[float]](), 0, name or mapped.name
        for n in numbers:
            for k, texts in enumerate(zip(*(mapped.cells[axis][n] for axis in axes), strict=False)):
                if all(texts):
                    rows.append(n)
                    points.append([mapped.read_number(axis, n, k) for axis in axes])
                else:
                    places = (mapped.list_columns(axis)[k : k + 1] for axis in axes)
                    missing += any(mapped.rows[n][place] for of_axis in places for place in of_axis)
        if missing:
            left_out.append(f"{missing} of {given}")
        if not points:
            continue
        values = np.pad(np.array(points), ((0, 0), (0, 3 - len(axes))))
        values = integrate_angles(*values.T[:2]) if is_angle else values
        titles, insertions = [given] * len(rows), list[ImportedCurve]()
        if kind.has_stops:  # places in space err along the needle, too: none has the depth of another
            titles = name_stops(titles, values[:, 0] if is_deflection else np.arange(1.0, len(rows) + 1))
        for title, part in group_values(zip(titles, count(), strict=False)).items():
            of_part = [rows[m] for m in part]
            lines = np.array([mapped.lines[n] for n in of_part], dtype=np.int64) if mapped.lines else None
            sds = _read_sds(mapped, of_part)
            curve = ImportedCurve(
                title,
                Points(Path(mapped.where), values[part], lines, sds),
                kind,
                mapped.read_facts(of_part, kind.varying),
                is_deflection=is_deflection,
                times=mapped.read_times(of_part) if is_timed else np.empty(0),
                guide=_read_guide(mapped, of_part),
                is_named=bool(name),
                given=given,
                origin=np.zeros(3) if is_deflection or len(rows) == 1 else values[0],
            )
            if is_deflection:
                curve.stated.pop("depth", None)
            if sds is not None and len(of_part) == 1:
                curve.stated["point_sd"] = Stated("point_sd", f"{sds[0]:.6g}", "mm", curve.points.where())
            kind.read(mapped, curve, of_part)
            insertions.append(curve)
        yield insertions


def name_stops(needles: Sequence[str], depths: Iterable[float | None]) -> list[str]:
    """Return the names of insertions: of a needle that was read at several depths each with its depth."""
    stops = [*zip(needles, depths, strict=True)]
    of_needles = group_values(stops)
    return [
        needle if depth is None or len({*of_needles[needle]}) == 1 else f"{needle}-{depth:g}"
        for needle, depth in stops
    ]


def integrate_angles(arcs: Floats, degrees: Floats) -> Floats:
    """Return the places (N, 3), mm, of a curve in a plane by its angles (N,) at lengths (N,), mm, from x."""
    angles, steps = np.radians(degrees), np.diff(arcs, prepend=0.0)
    means = (angles + np.roll(angles, 1)) / 2
    means[0] = angles[0]
    return np.column_stack([*np.cumsum(steps * [np.cos(means), np.sin(means)], axis=1), 0.0 * arcs])


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
    column = mapped.find_column("point_sd", record.divide_by_root)
    return sds / np.sqrt([mapped.number(mapped.rows[n][column]) or 1.0 for n in rows])


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


def _add_rows(mapped: MappedTable, curves: list[ImportedCurve]) -> None:
    """Add to needles what the rows of a table state of them: facts, turns or curvatures."""
    record, kind, needles = mapped.record, KINDS[mapped.record.holds], dict[str, str]()
    if record.of == "all":
        for curve in curves:
            kind.read(mapped, curve, mapped.kept_rows)
        return
    by_specimen = record.of == "specimen"
    names = ["".join(cells) for cells in mapped.cells["specimen"]] if by_specimen else mapped.names
    if kind.placer is not None:
        given = names if "needle" in record.columns else [mapped.name for _ in names]
        cells = enumerate(mapped.cells["depth"])
        names = name_stops(
            given, [mapped.read_number("depth", n) if any(texts) else None for n, texts in cells]
        )
        needles = dict(zip(names, given, strict=True))
    filled = [n for n in mapped.kept_rows if any(any(mapped.cells[key][n]) for key in record.columns)]
    rows = group_values((names[n], n) for n in filled)
    if blank := rows.get(""):
        edit = mapped.name_edit("fill_down", '["HEADER"]')
        raise DataError(
            f"names no {record.of}",
            expected="a name in each row",
            fix=f"fill it in; or, if the cell above counts: {edit}",
            where=mapped.places[blank[0]],
        )
    named = [*filter(None, names)]
    keys = {_make_key(name) for name in named}
    called = {
        curve: curve.stated["specimen"].text
        if by_specimen and "specimen" in curve.stated
        else curve.name
        if _make_key(curve.name) in keys
        else curve.given or curve.name
        for curve in curves
    }
    pairs = pair_names(named, called.values())
    strangers = [name for name in rows if name not in pairs]
    for name in strangers if needles else ():  # of which curvatures alone were measured
        points, unique = Points(mapped.path, np.empty((0, 3))), _make_name(name, [c.name for c in curves])
        curves.append(ImportedCurve(unique, points, kind, given=needles[name], hole=needles[name]))
        called[curves[-1]] = pairs[name] = name
    without = [*dict.fromkeys(name for name in called.values() if name not in pairs.values())]
    if not rows.keys() <= pairs.keys() or (without and kind.is_of_each):
        problem = f"no row is about {join_names(without, MAX_LISTED_NAMES)}"
        if strangers:
            problem = f"no {record.of} is called {join_names(strangers, MAX_LISTED_NAMES)}"
        listed = join_names([*without, *pairs.values()], MAX_LISTED_NAMES)
        unused = name_set("unused", json.dumps([mapped.sheet or mapped.path.name]))
        fix = "write the same names in both tables"
        if {curve.points.path.stem for curve in curves} >= {*rows}:  # its files are named so
            fix = f"state {name_set('needle.source', 'file')}"
        raise DataError(
            problem,
            expected=f"a row for each {record.of}: {listed}",
            fix=f"{fix}; or leave this one out: {unused}",
            where=mapped.where,
        )
    for name, numbers in rows.items():
        for curve in [curve for curve in curves if called[curve] == pairs[name]]:
            kind.read(mapped, curve, numbers)
    if kind.is_of_each:  # needles all of whose rows are excluded
        left_out = {pairs[name] for name in pairs.keys() - rows.keys()}
        curves[:] = [curve for curve in curves if called[curve] not in left_out]


# ---- names


def split_names(text: str) -> set[str]:
    """Return the names of needles in a value of the mapping."""
    return {name.strip() for name in text.split(",")} - {""}


# pattern of a word before the name of a needle: `needle_`, `needle`
_WORD = re.compile(r"[^\W\d_]{3,}|.*[-_ .]")


def pair_names(names: Iterable[str], others: Iterable[str]) -> dict[str, str]:
    """Return the other of each name: with the same id but for zeros, else with a word before one of the two.

    `1` and `01`, `3` and `needle_03`, `A1` and `needle A1`; only where one other is left that it may be.
    """
    keys = {_make_key(other): other for other in others}
    pairs = {name: keys[key] for name in names if (key := _make_key(name)) in keys}
    paired = {*pairs.values()}
    free = {key: other for key, other in keys.items() if other not in paired}
    left = {name: _make_key(name) for name in names if name and name not in pairs}
    likely = {
        name: [free[key] for key in free if _lacks_word(key, own_key)] for name, own_key in left.items()
    }
    counts = Counter(other for alike in likely.values() for other in alike)
    pairs |= {name: alike[0] for name, alike in likely.items() if [counts[other] for other in alike] == [1]}
    return pairs


def _lacks_word(key: str, other: str) -> bool:
    """Whether one of two keys is the other behind a word, or a number at its end."""
    shorter, longer = sorted((key, other), key=len)
    word = longer.removesuffix(shorter)
    is_number = shorter.isdecimal() and not word[-1:].isdecimal()
    return word != longer and (is_number or _WORD.fullmatch(word) is not None)


def _join_observations(needles: Iterable[list[ImportedCurve]]) -> None:
    """Give needles one hole where one has the name and depth of a shape; its tip stands beside the shape."""
    firsts = [needle[0] for needle in needles]
    shapes = {curve.given: curve for curve in firsts if curve.kind.has_shape and curve.is_named}
    for insertions in needles:
        for curve in tuple(insertions):
            shape, depths = shapes.get(curve.given, curve), curve.reading_depths
            is_end = shape is not curve and len(depths) > 0
            if is_end and abs(shape.depth - depths[-1]) <= find_length_tolerance(float(depths[-1])):
                for other in (shape, *insertions):
                    other.hole = curve.given
                if curve.kind.has_stops:
                    shape.tips += map(curve.read_tip, range(len(curve.line)))
                    insertions.remove(curve)


def _name_curves(needles: Sequence[Sequence[ImportedCurve]]) -> list[ImportedCurve]:
    """Return the insertions, each with an id of its own; several blocks of one table are numbered."""
    taken, blocks = set[str](), Counter(needle[0].given for needle in needles if not needle[0].is_named)
    numbers = Counter[str]()
    for insertions in needles:
        given = insertions[0].given
        if not insertions[0].is_named and blocks[given] > 1:
            numbers[given] += 1
            given = f"{given}-{numbers[given]}"
        name = _make_name(given, taken)
        for curve in insertions:
            stop = curve.name.removeprefix(curve.given)
            curve.given, curve.name = given, _make_name(f"{name}{stop}", taken)
            taken.add(curve.name)
            if curve.kind.has_stops and curve.is_named:
                curve.hole = curve.hole or name
        taken.add(name)
    return [curve for needle in needles for curve in needle]


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


def _make_key(name: str) -> str:
    """Return a name without zeros that change no number: 1 for `1.0` and `01`, n1 for `n01`; not 1.10."""
    whole = re.sub(r"^(\d+)\.0+$", r"\1", make_id(name, name)[:MAX_NAME_CHARS].lower())
    return re.sub(r"(?<![\d.])0+(?=\d)", "", whole)
