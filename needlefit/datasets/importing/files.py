"""Read all curves and surfaces, and what is stated of them, in the files and folders that an import names."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import as_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.importing.answers import Stated, add_stated
from needlefit.datasets.importing.curves import ATTRIBUTES, ImportContent, ImportedCurve, parse_columns
from needlefit.datasets.importing.joining import MAX_NAME_CHARS, join_needles, make_unique
from needlefit.datasets.importing.questions import QUESTIONS, name_option
from needlefit.datasets.importing.synonyms import find_meaning, list_meanings, read_header, split_unit
from needlefit.datasets.importing.table_reader import UNKNOWN_DOUBT, read_table
from needlefit.datasets.importing.tables import (
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    CellTable,
    UnclearLayoutError,
    UnclearTableError,
    parse_number,
    read_sheets,
    read_text_cells,
)
from needlefit.datasets.importing.tips import add_needles_without_points
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import ConfigError, refusal
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.geometry.surfaces import READ_SUFFIXES, read_coordinate_system, read_surface, transform_surface
from needlefit.project.input_files import is_dir, is_file, path_exists
from needlefit.project.locate import join_names

WORKBOOK_FILE = Path(__file__).with_name("workbook.xlsx")  # to fill in
EXAMPLE_SHEET = "example"  # how names of its sheets of examples begin
SETUP_SHEET = "setup"  # its sheet of answers
GUIDE_SHEET = "read me"  # its explanation
MAX_CURVES = 2000  # of an import, and as many files: more is a wrong folder
LAYOUTS = ("rows", "columns")
POINT_NAMES = ("entry", "target", "tip", "guide")  # what names points of needles, and no needle
UNIT_FIELDS = ("unit", "units")  # names of fields beside a curve, in lower case

# What to export of files that are not read, by their endings.
EXPORT_FIX = "export the points to one of these; scans are read by `needlefit reconstruct`"
_BAG_FIX = (
    "write the points of a topic as CSV, one a row, with columns needle, x, y, z and the unit in the headers"
)
_MESH_FIX = (
    "in ParaView: File, Save Data, CSV, a needle a file; then --columns Points:0,Points:1,Points:2. "
    "A surface between layers: export it as STL"
)
EXPORT_FIXES = {
    **dict.fromkeys((".bag", ".db3", ".mcap"), _BAG_FIX),
    **dict.fromkeys((".vtk", ".vtp", ".vtu"), _MESH_FIX),
}


def read_content(
    paths: Sequence[Path], columns: str | Mapping[str, str] = "", layout: str = ""
) -> ImportContent:
    """Read every file that is named, and the readable files of every folder that is named.

    `columns`: as `--columns` states them, or meanings by header or number; `layout`: `rows` or `columns`,
    where a table may be read as both.

    UnclearTableError if no header names coordinates, or a needle may stand in a row. DataError if the files
    hold no curve, or a bad one.
    """
    if layout not in ("", *LAYOUTS):
        raise refusal(f"""layout is {layout[:60]!r}
            expected: {" or ".join(LAYOUTS)}
            fix: correct {name_option("layout")}""")
    named = parse_columns(columns) if isinstance(columns, str) else columns
    content = ImportContent(named, layout)
    for path in itertools.islice(_list_files(paths, content), MAX_CURVES):
        _read_file(path, content)
    if not content.curves and content.unclear:
        raise content.unclear[0]
    if not content.curves:
        add_needles_without_points(content)
    if not 0 < len(content.curves) <= MAX_CURVES or len(content.files) == MAX_CURVES:
        raise refusal(f"""holds {len(content.curves)} curves of needles
            expected: 1 to {MAX_CURVES} needles in files that end in
                {", ".join(list_import_suffixes())}
            fix: name the files of their points, too
            where: {paths[0]}""")
    shapes = [one for one in content.curves if len(one.line) and not one.is_tip]
    if shapes and all(len(one.line) == 1 for one in shapes):
        names = join_names([one.name for one in shapes], 3)
        raise refusal(f"""holds one point of each of {len(shapes)} needles: {names}
            expected: at least {MIN_POINTS} points along each needle, or depth and deflection of each
                tip
            fix: name the columns of tips with --columns depth=HEADER,deflection=HEADER
            where: {shapes[0].points.where()}""")
    if faults := [fault for one in shapes for fault in one.points.find_faults(one.name)]:
        raise as_error(faults, paths[0])
    for name in content.columns.keys() - content.columns_found:
        raise refusal(f"""no table has a column {name!r}
            expected: a header or a number
            fix: correct --columns
            where: {paths[0]}""")
    curves: dict[str, ImportedCurve] = {}
    for one in content.curves:
        name = make_unique(make_id(one.name, "curve")[:MAX_NAME_CHARS], curves)
        curves[name] = replace(one, name=name)
    content.curves = [*curves.values()]
    join_needles(content)
    return content


def read_asking(
    paths: Sequence[Path],
    columns: str,
    layout: str,
    ask: Callable[[str, str, str], str] | None,
) -> ImportContent:
    """Return what files hold; `ask` is asked what tables mean that may mean several things.

    It takes a question, an answer to take by default, and the reason. UnclearTableError if nobody is asked.
    """
    try:
        content = read_content(paths, columns, layout)
    except UnclearTableError as error:
        which = "layout" if isinstance(error, UnclearLayoutError) else "columns"
        if ask is None or {"columns": columns, "layout": layout}[which]:
            raise
        stated = {"columns": columns, "layout": layout} | {
            which: ask(which, "", f"{error.where}: {error.what}")
        }
        return read_asking(paths, stated["columns"], stated["layout"], ask)
    if ask is None or not content.unknown:
        return content
    named = dict(content.columns)
    for what, where in dict.fromkeys(content.unknown):
        header = what.partition(" ")[2]
        question = f"What `{header}` is: {', '.join(ATTRIBUTES)}, or unrelated"
        meaning = ask(question, "unrelated", f"{where}: numbers under a header that is not known")
        named[header] = meaning or "unrelated"
    if unknown := {*named.values()} - {"x", "y", "z", *list_meanings()}:
        raise ConfigError.of(f"""a column is {min(unknown)[:60]!r}
            expected: {", ".join(list_meanings())}
            fix: answer with one of these""")
    return read_content(paths, named, layout)


def list_import_suffixes() -> tuple[str, ...]:
    """Return the endings of all files that an import reads."""
    plugins = {end for one in FORMATS.values() for end in one.suffixes}
    return tuple(sorted({*TEXT_SUFFIXES, *SHEET_SUFFIXES, *READ_SUFFIXES, *plugins}))


def _list_files(paths: Iterable[Path], content: ImportContent) -> Iterable[Path]:
    """Yield the files that are named, or stand in a folder that is."""
    for path in paths:
        if is_file(own := path if path.name == "dataset.toml" else path / "dataset.toml"):
            raise refusal(f"""is a dataset already
                expected: files of other programs
                fix: use it as it is: needlefit check {own}
                where: {path}""")
        if not is_dir(path):
            yield path
            continue
        for one in sorted(path.iterdir()):
            if one.is_dir():
                content.unused.append((f"folder {one.name}", "it is not searched: name it"))
            elif not one.name.lower().endswith(list_import_suffixes()) or one.name.startswith((".", "~$")):
                content.unused.append((f"file {one.name}", "its name"))
            else:
                yield one


def _read_file(path: Path, content: ImportContent) -> None:
    """Add what one file holds."""
    suffix = path.suffix.lower()
    content.files.append(path)
    if suffix in TEXT_SUFFIXES:
        read_table(read_text_cells(path), content)
    elif suffix in SHEET_SUFFIXES:
        _read_workbook(path, content)
    elif suffix in READ_SUFFIXES:
        surface, stated = read_surface(path, "sheet", 2), read_coordinate_system(path)
        surface = transform_surface(surface, RAS_TO_LPS) if stated == "RAS" else surface
        name = make_unique(surface.name[:MAX_NAME_CHARS], [one.name for one, *_ in content.surfaces])
        content.surfaces.append((replace(surface, name=name), path, "LPS" if stated else None))
    elif not path_exists(path):
        raise refusal(f"""there is no such file
            fix: check the name and the path
            where: {path}""")
    else:
        _read_format(path, content)


def _read_format(path: Path, content: ImportContent) -> None:
    """Add the curves of a file format of points, with what fields beside the points state."""
    format_ = find_format(path)
    if format_ is None or format_.read_curves is None:
        raise refusal(f"""has the ending {path.suffix!r}
            expected: {", ".join(list_import_suffixes())}
            fix: {EXPORT_FIXES.get(path.suffix.lower(), EXPORT_FIX)}
            where: {path}""")
    before = len(content.unused)
    found, remarks = format_.read_curves(path)
    unused = {text.removesuffix(" ignored"): None for text in remarks if text.endswith(" ignored")}
    readings = [text for text in remarks if not text.endswith(" ignored")]
    wrong = [name for name in found if find_meaning("column", name.rpartition("-")[2]) in POINT_NAMES]
    if wrong and readings:  # by their labels: `entry-1`, `tip-1`, `entry-2`
        raise refusal(f"""labels name points: {", ".join(wrong)}
            expected: labels of needles, as N1-1, N1-2, N2-1
            fix: rename the points after their needles, from entry to tip; remove points of no needle
            where: {path}""")
    unknown = dict[str, None]()  # numbers in fields that no language knows
    for name, points in found.items():
        unit, system = ("mm", "LPS") if format_.in_scan else (_read_unit(name, points), None)
        if points.columns:  # they may tell several needles apart
            read_table(_to_table(name, points, unit), content)
            continue
        axes = "; ".join([points.axes or ("x, y, z" if format_.in_scan else "columns 1, 2, 3"), *readings])
        stated = dict[str, Stated]()
        for key, text in points.stated.items():
            header, meaning = read_header(key), content.columns.get(key, "")
            content.columns_found |= {key} & content.columns.keys()
            meaning = meaning or header.meaning
            if text and meaning in ("needle", *ATTRIBUTES) and meaning not in stated:
                stated[meaning] = Stated(text, header.unit, f"{path}, field {key} of {name}")
            elif text and key.lower() not in UNIT_FIELDS:
                is_unknown = not meaning and parse_number(text, ".") is not None
                (unknown if is_unknown else unused)[f"field {key}"] = None
        title = stated.pop("needle", Stated(name)).text
        content.curves.append(ImportedCurve(title, points, unit, system, stated, axes))  # type: ignore[arg-type]
    content.unused += [(what, path.name) for what in unused]
    for what in unknown:
        content.leave_out(what, path.name, UNKNOWN_DOUBT)
        content.unknown.append((what, path.name))
    content.unused[before:] = dict.fromkeys(content.unused[before:])  # one line for the same of many needles


def _read_unit(name: str, points: Points) -> str:
    """Return the unit that fields beside a curve state; DataError if they state several."""
    texts = {text for key, text in points.stated.items() if key.lower() in UNIT_FIELDS}
    units = {find_meaning("unit", text) or text for text in {*texts, points.unit} if text}
    if len(units) > 1:
        raise refusal(f"""the unit of {name} is {" and ".join(sorted(units))}
            expected: one unit
            fix: correct the field of the unit
            where: {points.path}""")
    return units.pop() if units else ""


def _to_table(name: str, points: Points, unit: str) -> CellTable:
    """Return points and the columns beside them as a table below what is stated of all."""
    axes = [axis for axis in "xyz" if axis in points.axes.partition(";")[0]]
    above = [[key, text] for key, text in points.stated.items() if key.lower() not in UNIT_FIELDS]
    head = [f"{axis} [{unit}]" if unit else axis for axis in axes] + [*points.columns]
    numbers = points.values[:, : len(axes)].tolist()
    beside = zip(*points.columns.values(), strict=True)
    body = [[*map(repr, row), *texts] for row, texts in zip(numbers, beside, strict=True)]
    return CellTable(points.path, [*above, [], head, *body], name)


def _read_workbook(path: Path, content: ImportContent) -> None:
    """Add what all sheets hold, and the answers of the sheet `setup`.

    Sheets that begin with `example` are read where no other one holds rows below a header.
    """
    sheets = [one for one in read_sheets(path) if one.sheet.lower() != GUIDE_SHEET]
    plain = [one.sheet.lower() for one in sheets]
    own = [one for one, name in zip(sheets, plain, strict=True) if not name.startswith(EXAMPLE_SHEET)]
    points = [one for one in own if one.sheet.lower() != SETUP_SHEET]
    is_filled = len(own) == len(sheets) or any(sum(map(any, one.rows)) > 1 for one in points)
    for cells, name in zip(sheets, plain, strict=True):
        is_setup = name.removeprefix(EXAMPLE_SHEET).strip() == SETUP_SHEET
        if (cells not in own) == is_filled and not (is_setup and cells in own):
            why = "other sheets hold points" if is_filled else "empty: the examples are read"
            content.unused.append((f"sheet {cells.sheet}", why))
        elif is_setup:
            _read_setup(cells, content)
        else:
            read_table(cells, content)


def _read_setup(cells: CellTable, content: ImportContent) -> None:
    """Add the answers of a sheet with a row for each question: its name, value and unit."""
    for n, row in enumerate(cells.rows):
        name, value, unit = (*row, "", "", "")[:3]
        plain, own = split_unit(name)  # `boundaries [cm]`
        what = " ".join(plain.lower().replace("_", " ").split())
        what = what if what in QUESTIONS else find_meaning("column", plain)
        if value and what in QUESTIONS:
            unit = find_meaning("unit", unit) or unit
            stated = Stated(value, own or unit, cells.where(n, 1))
            if own and unit not in ("", own):
                raise stated.error(what, f"one unit, in its name or beside it ({unit})")
            add_stated(content.setup, {what: stated})
        elif value and n:
            what, near = f"row {name} = {value}"[:MAX_NAME_CHARS], get_close_matches(plain, QUESTIONS, 1)
            doubt = f"no value has this name; did you mean `{near[0]}`?" if near else "no value has this name"
            content.leave_out(what, Path(cells.where(n)).name, doubt)
