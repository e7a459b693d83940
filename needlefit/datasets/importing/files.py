"""Find and read all curves and surfaces in the files and folders that an import names."""

import itertools
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.importing.slicer_scene import ImportedSurface, read_scene
from needlefit.datasets.importing.tables import (
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    ImportedCurve,
    find_curves,
    read_sheets,
    read_text_cells,
)
from needlefit.errors import DataError
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.geometry.surfaces import READ_SUFFIXES, read_coordinate_system, read_surface, transform_surface
from needlefit.project.input_files import is_dir, path_exists
from needlefit.project.locate import join_names
from needlefit.schemas.names import EXPECTED_NAME, name_fault

SCENE_SUFFIXES = (".mrml", ".mrb")

MAX_FILES = 2000
MAX_CURVES = 5000
MAX_SHOWN_FILES = 8
MAX_NAME_CHARS = 60


@dataclass(frozen=True)
class ImportContent:
    """What the files of an import hold."""

    files: tuple[Path, ...]  # those that curves or surfaces were read from
    curves: tuple[ImportedCurve, ...]  # by different names, which can name files
    surfaces: tuple[ImportedSurface, ...]
    notes: tuple[str, ...]  # what was left out, or taken in a way that may surprise


def read_content(paths: Sequence[Path], columns: Sequence[str] = ()) -> ImportContent:
    """Read every file that is named, and the readable files of every folder that is named.

    `columns`: the headers or numbers of x, y and z in tables; else they are found.

    DataError listing what is wrong with all files, or because they hold no curve.
    """
    found: list[Fault] = []
    notes: list[str] = []
    files: list[Path] = []
    curves: list[ImportedCurve] = []
    surfaces: list[ImportedSurface] = []
    for path, is_named in _list_files(paths, notes):
        try:
            some, more, remarks = _read_file(path, columns)
        except DataError as error:
            if is_named or path.suffix.lower() not in TEXT_SUFFIXES or "no table" not in error.what:
                found.append(from_error(error, str(path)))
            else:
                notes.append(f"{path.name} is left out: it {error.what}")
            continue
        curves += some
        surfaces += more
        notes += [f"{path.name}: {remark}" for remark in remarks]
        files += [path] if some or more else []
    if not found and not curves:
        what = "holds surfaces, but no curve" if surfaces else "holds no file that can be read"
        expected = f"curves of needles in files that end in {', '.join(list_import_suffixes())}"
        found.append(Fault(str(paths[0]), what, expected, "name their files or folder"))
    found += [fault for one in curves for fault in one.points.find_faults(one.name)]
    if found:
        raise as_error(found, paths[0])
    names: dict[str, ImportedSurface] = {}
    for one in surfaces:
        plain = "".join(letter for letter in one.surface.name if letter.isprintable())[:MAX_NAME_CHARS]
        name = _make_unique(plain or "surface", names)
        names[name] = replace(one, surface=replace(one.surface, name=name))
    return ImportContent(tuple(files), _name_curves(curves), tuple(names.values()), tuple(notes))


def list_import_suffixes() -> tuple[str, ...]:
    """Return the endings of all files that an import reads."""
    plugins = {end for one in FORMATS.values() for end in one.suffixes}
    return tuple(sorted({*TEXT_SUFFIXES, *SHEET_SUFFIXES, *SCENE_SUFFIXES, *READ_SUFFIXES, *plugins}))


def _list_files(paths: Sequence[Path], notes: list[str]) -> list[tuple[Path, bool]]:
    """Return the files, and whether each is named itself; of a folder with a scene that one alone."""
    listed: list[tuple[Path, bool]] = []
    for path in paths:
        if not is_dir(path):
            listed.append((path, True))
            continue
        files = (one for one in sorted(path.iterdir()) if one.is_file())
        there = [one for one in files if not one.name.startswith((".", "~$"))]
        known = [one for one in there if one.name.lower().endswith(list_import_suffixes())]
        known = [one for one in known if one.suffix.lower() in SCENE_SUFFIXES] or known
        other = [one.name for one in there if one not in known]
        if other:
            names = join_names(other, MAX_SHOWN_FILES)
            notes.append(f"{len(other)} files of {path.name or path} are left out: {names}")
        listed += [(one, False) for one in known]
    if len(listed) > MAX_FILES:
        what = f"{len(listed)} files are named"
        where = str(paths[0])
        raise DataError(what, where=where, expected=f"at most {MAX_FILES}", fix="import them in parts")
    return listed


def _read_file(
    path: Path, columns: Sequence[str]
) -> tuple[Sequence[ImportedCurve], Sequence[ImportedSurface], Sequence[str]]:
    """Return the curves and surfaces of one file, with remarks on how it was read."""
    suffix = path.suffix.lower()
    if suffix in SCENE_SUFFIXES:
        scene = read_scene(path)
        return scene.curves, scene.surfaces, scene.notes
    if suffix in TEXT_SUFFIXES:
        cells = read_text_cells(path)
        return _with_stem(find_curves(cells, columns), path), (), [cells.layout]
    if suffix in SHEET_SUFFIXES:
        return _read_sheets(path, columns)
    if suffix in READ_SUFFIXES:
        surface, stated = read_surface(path, "sheet", 2), read_coordinate_system(path)
        surface = transform_surface(surface, RAS_TO_LPS) if stated == "RAS" else surface
        return (), [ImportedSurface(path, surface, "LPS" if stated else None)], ()
    if not path_exists(path):
        raise DataError("there is no such file", where=str(path), fix="check the name and the path")
    format_ = find_format(path)
    if format_ is None:
        what = f"has the ending {suffix!r}"
        fix = "export the points of the needles to one of these"
        raise DataError(what, where=str(path), expected=", ".join(list_import_suffixes()), fix=fix)
    named, remarks = format_.read_curves(path)
    unit, system = ("mm", "LPS") if format_.in_scan else ("", None)
    found = [ImportedCurve(name, points, unit, system) for name, points in named.items()]  # type: ignore[arg-type]
    return _with_stem(found, path), (), remarks


def _with_stem(curves: Sequence[ImportedCurve], path: Path) -> list[ImportedCurve]:
    """Return curves without names under that of their file."""
    stem = path.name.split(".")[0] or path.stem
    unnamed = sum(not one.name for one in curves)
    numbers = iter(range(1, len(curves) + 1))
    return [
        one if one.name else replace(one, name=stem if unnamed == 1 else f"{stem}-{next(numbers)}")
        for one in curves
    ]


def _read_sheets(path: Path, columns: Sequence[str]) -> tuple[list[ImportedCurve], tuple[()], list[str]]:
    """Return the curves of all sheets; those without numbers are left out."""
    by_sheet: dict[str, tuple[ImportedCurve, ...]] = {}
    remarks = []
    faults: list[DataError] = []
    for cells in read_sheets(path):
        try:
            by_sheet[cells.sheet] = find_curves(cells, columns)
        except DataError as error:
            faults.append(error)
            continue
        if not by_sheet[cells.sheet]:
            del by_sheet[cells.sheet]
            remarks.append(f"sheet {cells.sheet!r} is left out: it holds no coordinates")
    if faults and (not by_sheet or columns):
        raise faults[0]
    remarks += [f"left out: {error.where} {error.what}" for error in faults]
    found = [one for ones in by_sheet.values() for one in ones]
    if len(by_sheet) > 1:
        found = [
            replace(one, name=sheet if len(ones) == 1 else f"{sheet}-{one.name or n}")
            for sheet, ones in by_sheet.items()
            for n, one in enumerate(ones, 1)
        ]
    return _with_stem(found, path), (), remarks


def _name_curves(curves: Sequence[ImportedCurve]) -> tuple[ImportedCurve, ...]:
    """Return the curves under names that can name files, and of which no two are the same.

    DataError if there are too many, or a name could do something in a spreadsheet or terminal.
    """
    if len(curves) > MAX_CURVES:
        what = f"holds {len(curves)} curves"
        fix = "name the columns with --columns: one curve may have been taken for many"
        raise DataError(what, where=str(curves[0].points.path), expected=f"at most {MAX_CURVES}", fix=fix)
    names: dict[str, ImportedCurve] = {}
    for one in curves:
        if fault := name_fault(one.name):
            what = f"the name {one.name[:80]!r} of a curve is refused: {fault}"
            where = one.points.where()
            raise DataError(what, where=where, expected=EXPECTED_NAME, fix="rename it in its file")
        name = _make_unique(make_id(one.name, "curve")[:MAX_NAME_CHARS], names)
        names[name] = replace(one, name=name)
    return tuple(names.values())


def _make_unique(name: str, taken: Container[str]) -> str:
    """Return a name, numbered from 2 where it is taken."""
    numbered = (f"{name}-{count}" for count in itertools.count(2))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)
