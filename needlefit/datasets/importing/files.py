"""Read all curves and surfaces, and what is stated of them, in the files and folders that an import names."""

import itertools
from collections.abc import Container, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.formats.mat import NAMED_FIELDS
from needlefit.datasets.importing.answers import QUESTIONS
from needlefit.datasets.importing.curves import (
    ATTRIBUTES,
    ImportContent,
    ImportedCurve,
    ImportedSurface,
    add_stated,
    parse_columns,
    read_table,
)
from needlefit.datasets.importing.synonyms import Stated, find_meaning, make_key, read_header
from needlefit.datasets.importing.tables import (
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    CellTable,
    UnclearColumnsError,
    read_sheets,
    read_text_cells,
)
from needlefit.errors import DataError
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.geometry.surfaces import (
    READ_SUFFIXES,
    read_coordinate_system,
    read_surface,
    transform_surface,
)
from needlefit.project.input_files import is_dir, path_exists
from needlefit.schemas.names import EXPECTED_NAME, name_fault

# Sheets of the workbook to fill in: of examples (a beginning of names), answers, an explanation, points.
WORKBOOK_FILE = Path(__file__).with_name("workbook.xlsx")
EXAMPLE_SHEET, SETUP_SHEET, GUIDE_SHEET, EMPTY_SHEETS = "example", "setup", "read me", ("points", "needles")
MAX_FILES, MAX_CURVES, MAX_NAME_CHARS = 2000, 2000, 60


def read_content(paths: Sequence[Path], columns: str = "") -> ImportContent:
    """Read every file that is named, and the readable files of every folder that is named.

    `columns`: as `--columns` states them.

    UnclearColumnsError if no header names coordinates. DataError if the files hold no curve, or a bad one.
    """
    content = ImportContent(parse_columns(columns))
    files = list(_list_files(paths, content))
    if len(files) > MAX_FILES:
        what, where = f"{len(files)} files are named", str(paths[0])
        raise DataError(what, where=where, expected=f"at most {MAX_FILES}", fix="import them in parts")
    for path in files:
        _read_file(path, content)
    if not content.curves and content.unclear is not None:
        raise content.unclear
    if not 0 < len(content.curves) <= MAX_CURVES:
        left = ", ".join(what for what, _ in content.unused[:3])
        what = f"holds {len(content.curves)} curves of needles" + (f"; not read: {left}" if left else "")
        expected = f"1 to {MAX_CURVES} needles in files that end in {', '.join(list_import_suffixes())}"
        raise DataError(what, where=str(paths[0]), expected=expected, fix="name their files or folder")
    faults = [fault for one in content.curves for fault in one.points.find_faults(one.name)]
    for one in content.curves:
        if why := name_fault(one.name):
            what = f"the name {one.name[:80]!r} of a curve is refused: {why}"
            faults.append(Fault(one.points.where(), what, EXPECTED_NAME, "rename it in its file"))
    if faults:
        raise as_error(faults, paths[0])
    for meaning in content.columns.keys() - content.columns_found:
        what = f"no table has a column {content.columns[meaning]!r}"
        raise DataError(what, where=str(paths[0]), expected="a header or a number", fix="correct --columns")
    curves, surfaces = dict[str, ImportedCurve](), dict[str, ImportedSurface]()
    for one in content.curves:
        name = _make_unique(make_id(one.name, "curve")[:MAX_NAME_CHARS], curves)
        curves[name] = replace(one, name=name)
    for layer in content.surfaces:
        plain = "".join(letter for letter in layer.surface.name if letter.isprintable())[:MAX_NAME_CHARS]
        name = _make_unique(plain or "surface", surfaces)
        surfaces[name] = replace(layer, surface=replace(layer.surface, name=name))
    content.curves, content.surfaces = [*curves.values()], [*surfaces.values()]
    _add_stated(content)
    return content


def _make_unique(name: str, taken: Container[str]) -> str:
    """Return a name, numbered from 2 where it is taken."""
    numbered = (f"{name}-{count}" for count in itertools.count(2))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)


def _add_stated(content: ImportContent) -> None:
    """Add to the curves what tables state of needles by their names.

    DataError if tables state something of needles, and of none that has a curve.
    """
    keys = [make_key(one.name) for one in content.curves]
    is_own = len({*keys}) == len(keys)
    keys = keys if is_own else [one.name.lower() for one in content.curves]  # only words tell them apart
    rows: dict[str, dict[str, Stated]] = {}
    missed = []
    for name, stated in content.needles:
        key = make_key(make_id(name, name)) if is_own else make_id(name, name).lower()
        add_stated(rows.setdefault(key, {}), stated)
        missed += [] if key in keys else [name]
    for n, (one, key) in enumerate(zip(content.curves, keys, strict=True)):
        known = dict(one.stated)
        add_stated(known, rows.get(key, {}))
        content.curves[n] = replace(one, stated=known)
    if missed and len(missed) == len(content.needles):
        where = next((one.where for _, stated in content.needles for one in stated.values()), "")
        what, fix = f"no curve is called {', '.join(missed[:8])}", "give needles and curves the same names"
        expected = f"names of curves: {', '.join(one.name for one in content.curves[:8])}"
        raise DataError(what, where=where, expected=expected, fix=fix)
    content.unused += [(f"row of needle {name}", "no curve has its name") for name in missed]


def list_import_suffixes() -> tuple[str, ...]:
    """Return the endings of all files that an import reads."""
    plugins = {end for one in FORMATS.values() for end in one.suffixes}
    return tuple(sorted({*TEXT_SUFFIXES, *SHEET_SUFFIXES, *READ_SUFFIXES, *plugins}))


def _list_files(paths: Iterable[Path], content: ImportContent) -> Iterable[Path]:
    """Yield the files that are named, or stand in a folder that is."""
    for path in paths:
        if not is_dir(path):
            yield path
            continue
        shown = [one for one in sorted(path.iterdir()) if not one.name.startswith((".", "~$"))]
        known = [one for one in shown if one.is_file() and one.name.lower().endswith(list_import_suffixes())]
        left = [one for one in shown if one not in known]
        content.unused += [
            (f"folder {one.name}", "it is not searched: name it")
            if one.is_dir()
            else (f"file {one.name}", "its ending")
            for one in left
        ]
        yield from known


def _read_file(path: Path, content: ImportContent) -> None:
    """Add what one file holds."""
    suffix = path.suffix.lower()
    content.files.append(path)
    if suffix in TEXT_SUFFIXES:
        try:
            cells = read_text_cells(path)
            content.notes.append(f"{path.name}: {cells.layout}")
            read_table(cells, content)
        except UnclearColumnsError as error:
            content.leave_out(f"file {path.name}", error)
    elif suffix in SHEET_SUFFIXES:
        _read_workbook(path, content)
    elif suffix in READ_SUFFIXES:
        surface, stated = read_surface(path, "sheet", 2), read_coordinate_system(path)
        surface = transform_surface(surface, RAS_TO_LPS) if stated == "RAS" else surface
        content.surfaces.append(ImportedSurface(path, surface, "LPS" if stated else None))
    elif not path_exists(path):
        raise DataError("there is no such file", where=str(path), fix="check the name and the path")
    else:
        _read_format(path, content)


def _read_format(path: Path, content: ImportContent) -> None:
    """Add the curves of a file format of points, with what fields beside the points state."""
    format_ = find_format(path)
    if format_ is None:
        what, expected = f"has the ending {path.suffix!r}", ", ".join(list_import_suffixes())
        raise DataError(what, where=str(path), expected=expected, fix="export the points to one of these")
    found, remarks = format_.read_curves(path)
    unused = dict.fromkeys(remark.removesuffix(" ignored") for remark in remarks)
    order = [content.columns.get(axis, "") for axis in "xyz"]
    curves = []
    for name, points in found.items():
        axes = "the format" if format_.in_scan else "fields x, y, z" if NAMED_FIELDS in points.stated else ""
        if not axes and sorted(order) == ["1", "2", "3"]:
            content.columns_found |= {*"xyz"}
            axes = "--columns"
            points = replace(points, values=points.values[:, [int(number) - 1 for number in order]])
        stated: dict[str, Stated] = {}
        for key, text in points.stated.items():
            header = read_header(key)
            if text and header.meaning in ("needle", *ATTRIBUTES) and header.meaning not in stated:
                stated[header.meaning] = Stated(text, header.unit, f"{path}, field {key} of {name}")
            elif text:
                unused[f"field {key}"] = None
        unit, system = ("mm", "LPS") if format_.in_scan else ("", None)
        curves.append(ImportedCurve(name, points, unit, system, stated, axes))  # type: ignore[arg-type]
    own = {one.stated["needle"].text for one in curves if "needle" in one.stated}
    for one in curves:
        title = one.stated.get("needle")
        one = replace(one, stated={what: cell for what, cell in one.stated.items() if what != "needle"})
        if len(own) == len(curves) and title is not None:
            one = replace(one, name=title.text)
        elif title is not None:  # one name of all is that of the experiment
            unused[f"field {title.text}"] = None
        content.curves.append(one)
    content.unused += [(what, path.name) for what in unused]


def _read_workbook(path: Path, content: ImportContent) -> None:
    """Add what all sheets hold, and the answers of the sheet `setup`.

    Sheets called `example` are those of the workbook to fill in: they are used where no other holds curves.
    """
    own, examples = (ImportContent(content.columns, content.columns_found) for _ in range(2))
    names = []
    for cells in read_sheets(path):
        plain = cells.sheet.lower()
        is_example = plain.startswith(EXAMPLE_SHEET)
        names += [cells.sheet] if is_example else []
        filled = sum(map(any, cells.rows))
        if plain == GUIDE_SHEET or (plain in EMPTY_SHEETS and filled < 2):
            continue
        try:
            if plain.removeprefix(EXAMPLE_SHEET).strip() == SETUP_SHEET:
                _read_setup(cells, examples if is_example else own)
            elif filled:
                read_table(cells, examples if is_example else own)
            else:
                own.unused.append((f"sheet {cells.sheet}", "it is empty"))
        except UnclearColumnsError as error:
            own.leave_out(f"sheet {cells.sheet}", error)
    why = "not read: other sheets hold points" if own.curves else "read: no other sheet holds points"
    content.notes += [f"{path.name}: examples ({', '.join(names)}) are {why}"] if names else []
    for one in (own,) if own.curves else (own, examples):
        content.curves += one.curves
        content.needles += one.needles
        content.notes += one.notes
        content.unused += one.unused
        add_stated(content.setup, one.setup)
    content.unclear = content.unclear or own.unclear


def _read_setup(cells: CellTable, content: ImportContent) -> None:
    """Add the answers of a sheet with a row for each question: its name, value and unit.

    DataError if a unit is not that of the question.
    """
    for n, row in enumerate(cells.rows):
        name, value, unit = (*row, "", "", "")[:3]
        what = " ".join(name.lower().replace("_", " ").split())
        what = what if what in QUESTIONS else find_meaning("column", name)
        if not value or (n == 0 and value.lower() == "value"):
            continue
        if what not in QUESTIONS:
            content.unused.append((f"row {name} = {value}"[:MAX_NAME_CHARS], Path(cells.where(n)).name))
            continue
        expected = QUESTIONS[what].unit
        if unit and find_meaning("unit", unit) != expected:
            text, fix = f"the unit of {what} is {unit[:40]!r}", "convert the value, and restore the unit"
            raise DataError(text, where=cells.where(n, 2), expected=expected or "no unit", fix=fix)
        add_stated(content.setup, {what: Stated(value, unit, cells.where(n, 1))})
