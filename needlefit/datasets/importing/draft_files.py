"""Propose a mapping of files that nobody has described: what is sure, what is assumed, and what is open.

It reads no needle: a person sees what is proposed, and `read` goes by that.
"""

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import permutations
from pathlib import Path

from needlefit.datasets.folds import MAX_NAMED_SPECIMENS
from needlefit.datasets.formats import FORMATS
from needlefit.datasets.formats.markups import holds_markups, is_plane, read_markups
from needlefit.datasets.importing.draft import Draft
from needlefit.datasets.importing.draft_entries import draft_entries
from needlefit.datasets.importing.examples import EXAMPLE_SHEET
from needlefit.datasets.importing.kinds import KINDS
from needlefit.datasets.importing.layout import propose_layout, sniff_text
from needlefit.datasets.importing.meanings import (
    NAMED_BY_LAYER,
    VALUES,
    Keys,
    Pairs,
    find_meaning,
    read_header,
    split_unit,
)
from needlefit.datasets.importing.read import MAX_CURVES, split_names
from needlefit.datasets.importing.stated import name_set
from needlefit.datasets.importing.table_rows import lay_out
from needlefit.datasets.importing.tables import (
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    Table,
    is_like_number,
    name_files,
    name_stem,
    read_sheets,
    read_structured,
)
from needlefit.datasets.points import MIN_POINTS
from needlefit.errors import DataError
from needlefit.geometry.surfaces import READ_SUFFIXES
from needlefit.project.input_files import is_dir, is_file, path_exists
from needlefit.project.locate import join_names, sort_by_similarity
from needlefit.project.toml import check, override
from needlefit.project.units import UNITS_MM
from needlefit.schemas.mapping import TableRecord

SETUP_SHEET, GUIDE_SHEET = "setup", "read me"  # of the workbook to fill in
MAPPING_TEXTS = ("title", "source", "license", "entry", "bevel", "guide")  # values that are no columns


def draft_mapping(paths: Sequence[Path], pairs: Pairs) -> tuple[Draft, list[Path]]:
    """Return the proposed mapping of files and of the readable files of folders, and these files.

    DataError of a file that cannot be read, or holds a dataset already.
    """
    draft = Draft(pairs)
    files = list_different(_list_files(paths, draft))
    draft.names = name_files(files)
    if len(files) > MAX_CURVES:
        raise DataError(
            f"{len(files)} files are named",
            expected=f"at most {MAX_CURVES}",
            fix="name the folder of the needles",
        )
    for path in files:
        suffix = path.suffix.lower()
        if suffix in READ_SUFFIXES or path.name in draft.planes or is_plane(path):
            draft.surfaces.append(draft.names[path])
        elif suffix in TEXT_SUFFIXES:
            _draft_grid(*sniff_text(path, draft.table_keys), draft)
        elif suffix in SHEET_SUFFIXES:
            _draft_workbook(path, draft)
        else:
            table, remarks = read_structured(path)
            draft.unused += [(remark, path.name) for remark in remarks]
            draft_entries(table, {"files": [path.name]}, draft)
            _ask_markups(path, table, draft, files)
    for meaning, parts in draft.columns.items():
        if "column" in parts and draft.headers and meaning not in draft.columns_read:
            raise DataError(
                f"no table has the column {parts['column']!r}, of which {meaning} is to be read",
                expected=f"one of {', '.join(dict.fromkeys(draft.headers))}"[:400],
                fix=name_set(f"{meaning}.column", sort_by_similarity(parts["column"], draft.headers)[0]),
            )
    for key, text in draft.numbered:
        pairs, (meaning, part) = [(key, text)], key.split(".")[-2:]
        if part == "column" and (unit := read_header(text).unit):
            pairs.insert(0, (f"{key.removesuffix(part)}unit", unit))
        (draft.tables,) = override({"tables": draft.tables}, pairs, "--set").values()
        for settled in (key.split(".")[2], meaning, f"unused.{text}"):
            draft.assumed.pop(settled, None)
    if "specimen" not in {*draft.columns, *draft.values}:
        _ask_sources(draft)
        _ask_specimens(draft, files)
    if not draft.opens and not any(KINDS[table["holds"]].placer for table in draft.tables):
        problem = "; ".join(
            f"{part}: {why}" for part, why in draft.unused if part.startswith(("table", "folder"))
        )
        known = {*draft.columns}.union(*(table["columns"] for table in draft.tables))
        needed = [key for key in ("depth", "deflection") if key not in known]
        numbers = [key.partition(".")[2] for key in draft.assumed if key.startswith("unused.")]
        for key in needed if len(needed) < 2 else "xy":
            lengths = [name for name in numbers if read_header(name).unit in ("", "px", *UNITS_MM)]
            answers = {name: {f"{key}.column": name} for name in lengths}
            draft.ask_column(key, str(paths[0]), answers, f" ({problem or paths[0]})")
    read = {name for table in draft.tables for name in table["files"]}
    for path in paths if not draft.opens else ():
        if (name := draft.names.get(path, "")) in draft.ignored.keys() - read:
            draft.ask("ignored", name, name=name, why=draft.ignored[name])
    return draft, files


def _ask_markups(path: Path, table: Table, draft: Draft, files: Sequence[Path]) -> None:
    """Ask about a list of Slicer with few points, perhaps of a boundary, or named as other needles."""
    key = f"tables.{len(draft.tables)}.holds"
    if not holds_markups(path) or (key, "shapes") in draft.numbered:
        return
    for name, count in Counter(row[0] for row in table.rows).items():
        if count < MIN_POINTS:
            answers = {"needle": {key: "shapes"}, "boundary": {"surfaces": path.name}}
            draft.ask("markups", path.name, answers, name=name, count=count)
    others = {other.name.partition(".")[0] for other in files if other != path}
    left_out = split_names(draft.values.get("leave_out", ""))
    for markups in read_markups(path):
        named = others.intersection(markups.labels)
        is_open = len(named) > 1 and markups.name not in left_out
        if is_open and not any(map(str.isdecimal, named)):  # Slicer itself counts points
            names = ",".join(sorted({*left_out, markups.name}))
            answers = {"no": {"leave_out": names}, "needle": {key: "shapes"}}
            draft.ask("named_points", path.name, answers, name=markups.name)


def list_different(paths: Iterable[Path]) -> list[Path]:
    """Return paths without those of a file that is named already."""
    return [*{path.absolute(): path for path in paths}.values()]


def _list_files(paths: Iterable[Path], draft: Draft) -> Iterator[Path]:
    """Yield the files that are named, or stand in a folder that is."""
    ends = tuple(end for entry in FORMATS.values() for end in entry.suffixes)
    suffixes = (*TEXT_SUFFIXES, *SHEET_SUFFIXES, *READ_SUFFIXES, *ends)
    for path in paths:
        if is_file(dataset := path if path.name == "dataset.toml" else path / "dataset.toml"):
            raise DataError(
                "is a dataset already",
                expected="files of other programs",
                fix=f"use it as it is: needlefit check {dataset}",
                where=path,
            )
        if not is_dir(path):
            if not path_exists(path):
                raise DataError("there is no such file", fix="check the name and the path", where=path)
            yield path
            continue
        entries = list_entries(path)
        folders = [str(entry) for entry in entries if entry.is_dir()]
        named = [entry for entry in entries if entry.is_file() and not entry.name.startswith((".", "~$"))]
        readable = [entry for entry in named if entry.name.lower().endswith(suffixes)]
        draft.unused += [(f"folder {Path(name).name}", "it is not searched: name it") for name in folders]
        draft.unused += [(f"file {entry.name}", "its name") for entry in named if entry not in readable]
        if folders and not named:
            raise DataError(
                "holds folders alone, which are not searched",
                expected="files of needles",
                fix=f"name the folders of the files: needlefit import {shlex.join(folders[:3])}",
                where=path,
            )
        yield from readable or named[:1]  # which states why it is not read


def list_entries(folder: Path) -> list[Path]:
    """Return what a folder holds; of folders alone, one for each specimen, what they hold."""
    entries = sorted(folder.iterdir())
    are_folders = all(entry.is_dir() for entry in entries)
    return sorted(file for entry in entries for file in entry.iterdir()) if are_folders else entries


def _ask_sources(draft: Draft) -> None:
    """Ask what sheets, or files, are of one kind whose needles have the same names.

    It waits for an answer that may state specimens.
    """
    if any("specimen.column" in keys for asked in draft.opens for keys in asked.choices.values()):
        return
    entries = {
        (file, table.get("sheet", "")): (n, table["holds"])
        for n, table in enumerate(draft.tables, 1)
        for file in table["files"]
    }
    places = [
        place
        for place, other in permutations(draft.needles, 2)
        if entries[place][1] == entries[other][1] and draft.needles[place] & draft.needles[other]
    ]
    if not places:
        return
    source = "sheet" if len({file for file, _ in places}) == 1 else "file"
    names = [*dict.fromkeys(sheet if source == "sheet" else file for file, sheet in places)]
    listed = f"{source.capitalize()}s {join_names(names, 4)}"
    draft.ask(
        "source",
        places[0][0],
        source=source,
        places=listed,
        last=names[-1],
        number=entries[places[-1]][0],
    )


def _ask_specimens(draft: Draft, files: Sequence[Path]) -> None:
    """Ask whether folders, or parts `block1` of the names of files, are specimens, if no column names any."""
    read = {name for table in draft.tables if KINDS[table["holds"]].placer for name in table["files"]}
    paths = [path for path in files if draft.names[path] in read]
    if draft.opens or any("specimen" in table["columns"] for table in draft.tables):
        return
    folders = dict.fromkeys(path.absolute().parent.name for path in paths)
    if len(folders) > 1:
        draft.ask("specimens", "", source="folder", names=join_names([*folders], MAX_NAMED_SPECIMENS))
        return
    stems = [name_stem(path) for path in paths]
    words = dict.fromkeys(
        word for stem in stems for word in re.findall(r"[A-Z]?[a-z]{3,}|[^\W\d_]{3,}", stem)
    )
    for word in [word for word in words if "specimen" in find_meaning("column", word)]:
        pattern = rf".*?({word}[-_ ]?[^\W_]+).*"
        names = dict.fromkeys(match[1] for stem in stems if (match := re.fullmatch(pattern, stem)))
        if 1 < len(names) < len(stems):
            answers = {
                "yes": {"specimen.source": "file", "specimen.pattern": pattern},
                "no": {"specimen": "each"},
            }
            draft.ask("specimens", "", answers, source=word, names=join_names([*names], MAX_NAMED_SPECIMENS))


# ---- sheets and grids


def _draft_workbook(path: Path, draft: Draft) -> None:
    """Propose the sheets of a workbook; those that begin with `example` where no other one is filled in."""
    sheets = [sheet for sheet in read_sheets(path) if sheet.sheet.lower() != GUIDE_SHEET]
    examples = [sheet for sheet in sheets if sheet.sheet.lower().startswith(EXAMPLE_SHEET)]
    are_filled = any(
        sheet not in examples and sheet.sheet.lower() != SETUP_SHEET and sum(map(any, sheet.rows)) > 1
        for sheet in sheets
    )
    for grid in sheets:
        keys: Keys = {"files": [path.name], "sheet": grid.sheet}
        if (grid in examples) == (are_filled or not examples):
            draft.unused.append((f"sheet {grid.sheet}", path.name))
        else:
            _draft_grid(grid, keys, draft)


def _states_values(grid: Table) -> bool:
    """Whether a sheet has a name and a value of all needles in each row, as `setup` of the workbook has."""
    if grid.sheet.lower().removeprefix(EXAMPLE_SHEET).strip() == SETUP_SHEET:
        return True
    names = [read_header(row[0]).meaning for row in grid.rows if any(row)]
    widths = {sum(map(bool, row)) for row in grid.rows}
    is_narrow = 1 < max(widths, default=0) < 4 and not any(
        is_like_number(text) for row in grid.rows for text in row[2:]
    )
    return is_narrow and sum(name in VALUES for name in names) > 1


def _draft_values(grid: Table, keys: Keys, draft: Draft) -> None:
    """Propose what a sheet of names and values states of all."""
    table = lay_out(grid, check(keys, TableRecord, grid.path))
    draft.unused += [(f"line `{line}`"[:200], grid.path.name) for line in table.unread]
    rows, columns = dict[str, list[str]](), dict[str, Keys]()
    for header, text in zip(table.headers, table.rows[0], strict=True):
        named, unit = split_unit(header)
        name = read_header(split_unit(named)[0])
        key = "_".join(name.text.lower().replace("_", " ").split())
        key = key if key in VALUES or key == "origin" else name.meaning
        if key == "origin":
            draft.origin = draft.origin or text
        elif key in MAPPING_TEXTS:
            draft.values.setdefault(key, text)
        elif key not in (*VALUES, *NAMED_BY_LAYER):
            draft.unused.append((f"row {header} = {text}", Path(grid.where).name))
        elif key not in draft.stated:
            rows.setdefault(key, []).append(header)
            columns[key] = {"column": rows[key], "unit": unit or name.unit}
    if columns:
        draft.add(keys | {"columns": columns}, grid.path)


def _draft_grid(grid: Table, keys: Keys, draft: Draft) -> None:
    if not any(map(any, grid.rows)):
        draft.unused.append((f"sheet {grid.sheet}" if grid.sheet else f"file {grid.path.name}", "empty"))
        return
    if _states_values(grid):
        is_head = any(find_meaning("heading", text) for text in grid.rows[0])
        keys |= {"layout": "pairs", "holds": "facts", "of": "all", "header_rows": [1] if is_head else []}
        _draft_values(grid, keys, draft)
        return
    keys = propose_layout(grid, keys | draft.table_keys)
    table = lay_out(grid, check({"holds": "facts"} | keys, TableRecord, grid.path))
    draft.unused += [(f"line `{line}`"[:200], grid.path.name) for line in table.unread]
    draft_entries(table, keys, draft)
