"""Propose a mapping of files that nobody has described: what is sure, what is assumed, and what is open.

It reads no needle: a person sees what is proposed, and `read` goes by that.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import permutations
from pathlib import Path

from needlefit.datasets.folds import MAX_NAMED_SPECIMENS
from needlefit.datasets.formats import FORMATS
from needlefit.datasets.formats.markups import holds_markups, is_plane, read_markups
from needlefit.datasets.importing.draft import Draft
from needlefit.datasets.importing.draft_table import (
    EXCLUDED,
    MAX_FLAGS,
    OF_LAYERS,
    Column,
    Columns,
    TableDraft,
    join_columns,
    to_inline_table,
)
from needlefit.datasets.importing.kinds import KINDS, RowKind, list_kinds
from needlefit.datasets.importing.layout import lay_out, propose_layout, sniff_text
from needlefit.datasets.importing.meanings import (
    ATTRIBUTES,
    COORDINATES,
    MEANINGS,
    NAMED_BY_LAYER,
    VALUES,
    VECTORS,
    Keys,
    Pairs,
    find_meaning,
    list_bare_numbers,
    read_header,
    read_side,
    split_unit,
)
from needlefit.datasets.importing.read import MAX_CURVES, split_names
from needlefit.datasets.importing.stated import name_set
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

# beginnings of the names of sheets of the workbook to fill in
EXAMPLE_SHEET, SETUP_SHEET, GUIDE_SHEET = "example", "setup", "read me"


_PAIR = re.compile(r"\d *(?:±|\+/-) *[\d.]")  # pattern of a number with its error: `0.6 ± 0.1`


def draft_mapping(paths: Sequence[Path], pairs: Pairs) -> tuple[Draft, list[Path]]:
    """Return the proposed mapping of files and of the readable files of folders, and these files.

    DataError of a file that cannot be read, or holds a dataset already.
    """
    draft = Draft(pairs)
    files = list_files(paths, draft.unused)
    draft.names = name_files(files)
    if len(files) > MAX_CURVES:
        raise DataError(
            f"{len(files)} files are named",
            expected=f"at most {MAX_CURVES}",
            fix="name the folder of the needles",
        )
    again = Draft(pairs)
    again.names, again.unused = draft.names, [*draft.unused]
    _draft_files(files, draft)
    if draft.curves and not all(KINDS[table["holds"]].has_points for table in draft.tables):
        # the column that names needles in a table of facts may be known by curves of a later file
        again.curves, draft = draft.curves, again
        _draft_files(files, draft)
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
    read = {name for table in draft.tables for name in table["files"]}
    left = draft.ignored.keys() & {draft.names.get(path, "") for path in paths} - read
    if not draft.opens and (left or not any(KINDS[table["holds"]].placer for table in draft.tables)):
        problem = "; ".join(
            f"{part}: {why}" for part, why in draft.unused if part.startswith(("table", "folder"))
        )
        meanings = {*draft.columns}.union(*(() if left else table["columns"] for table in draft.tables))
        needed = [key for key in ("depth", "deflection") if key not in meanings]
        numbers = [key.partition(".")[2] for key in draft.assumed if key.startswith("unused.")]
        numbers += [name for names in draft.ignored.values() for name in names]
        lengths = [name for name in numbers if read_header(name).unit in ("", "px", *UNITS_MM)]
        keys = needed if len(needed) < 2 else [key for key in "xy" if key not in draft.columns]
        for key in keys or "y" * len(left):
            answers = {name: {f"{key}.column": name} for name in lengths}
            if key == "x" and draft.ignored:
                answers |= {f"{name}, a depth": {"depth.column": name} for name in lengths}
            answers |= {f"without {name}": {"unused": json.dumps([name])} for name in left}
            text = f"{MEANINGS[key].text} ({problem or paths[0]})"
            draft.ask("column", str(paths[0]), answers, key=key, text=text)
    return draft, files


def _draft_files(files: Sequence[Path], draft: Draft) -> None:
    """Propose what each file holds."""
    for path in files:
        suffix = path.suffix.lower()
        if suffix in READ_SUFFIXES or path.name in draft.planes or is_plane(path):
            draft.surfaces.append(draft.names[path])
        elif suffix in TEXT_SUFFIXES:
            _draft_grid(*sniff_text(path, draft.table_keys), draft)
        elif suffix in SHEET_SUFFIXES:
            _draft_workbook(path, draft)
        else:
            draft_entries(table := read_structured(path), {"files": [path.name]}, draft)
            _ask_markups(path, table, draft, files)


def _ask_markups(path: Path, table: Table, draft: Draft, files: Sequence[Path]) -> None:
    """Ask about a list of Slicer with few points, perhaps of a boundary, or named as other needles."""
    key = f"tables.{len(draft.tables)}.holds"
    if not holds_markups(path) or (key, "shapes") in draft.numbered:
        return
    for name, count in Counter(row[0] for row in table.rows).items():
        if count < MIN_POINTS:
            draft.ask("markups", path.name, name=name, count=count, file=path.name, number=len(draft.tables))
    others = {other.name.partition(".")[0] for other in files if other != path}
    left_out = split_names(draft.values.get("leave_out", ""))
    for markups in read_markups(path):
        named = others.intersection(markups.labels)
        is_open = len(named) > 1 and markups.name not in left_out
        if is_open and not any(map(str.isdecimal, named)):  # Slicer itself counts points
            names = ",".join(sorted({*left_out, markups.name}))
            draft.ask("named_points", path.name, name=markups.name, names=names, number=len(draft.tables))


def list_files(paths: Iterable[Path], unused: list[tuple[str, str]]) -> list[Path]:
    """Return the files that are named, or stand in a folder that is; `unused` gets what is not read."""
    files = list[Path]()
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
            files.append(path)
            continue
        entries = list_entries(path)
        folders = [str(entry) for entry in entries if entry.is_dir()]
        named = [entry for entry in entries if entry.is_file() and not entry.name.startswith((".", "~$"))]
        readable = [entry for entry in named if entry.name.lower().endswith(suffixes)]
        unused += [(f"folder {Path(name).name}", "it is not searched: name it") for name in folders]
        unused += [(f"file {entry.name}", "its name") for entry in named if entry not in readable]
        files += readable or named[:1]  # which states why it is not read
    return [*{path.absolute(): path for path in files}.values()]


def list_entries(folder: Path) -> list[Path]:
    """Return what a folder holds; of folders alone, as of specimens and needles, what they hold."""
    entries = sorted(folder.iterdir())
    are_folders = all(entry.is_dir() for entry in entries)
    return sorted(file for entry in entries for file in list_entries(entry)) if are_folders else entries


def _ask_sources(draft: Draft) -> None:
    """Ask what sheets, or files, are of one kind whose needles have the same names, and not those of files.

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
    if draft.columns.get("needle", {}).get("source") == source:
        return
    names = [*dict.fromkeys(sheet if source == "sheet" else file for file, sheet in places)]
    listed = f"{source.capitalize()}s {join_names(names, 4)}"
    are_single = all(len(draft.needles[place]) == 1 for place in places)
    draft.ask(
        "source_of_one" if are_single else "source",
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
    names = [name_stem(path, draft.names[path]) for path in paths]
    words = dict.fromkeys(re.findall(r"[A-Z]?[a-z]{3,}|[^\W\d_]{3,}", " ".join(names)))
    patterns = {
        word: rf".*?({word}[-_ ]?[^\W_]+).*" for word in words if "specimen" in find_meaning("column", word)
    }
    outer = {name.partition("/")[0] for name in names if name.count("/") > 1}
    if 1 < len(outer) < len(names):  # each holds a folder for each needle
        patterns = {"folder": "(.+?)/.*"}
    elif len(folders) > 1:
        draft.ask("specimens", "", names=join_names([*folders], MAX_NAMED_SPECIMENS))
        return
    for word, pattern in patterns.items():
        parts = dict.fromkeys(match[1] for name in names if (match := re.fullmatch(pattern, name)))
        if 1 < len(parts) < len(names):
            listed = join_names([*parts], MAX_NAMED_SPECIMENS)
            draft.ask("named_specimens", "", word=word, pattern=pattern, names=listed)


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
    draft.unused += [(line, grid.path.name) for line in table.unread]
    rows, columns = dict[str, list[str]](), dict[str, Keys]()
    for header, text in zip(table.headers, table.rows[0], strict=True):
        named, unit = split_unit(header)
        name = read_header(split_unit(named)[0])
        key = "_".join(name.text.lower().replace("_", " ").split())
        key = key if key in VALUES or key == "origin" else name.meaning
        if key == "origin":
            draft.origin = draft.origin or text
        elif key in VALUES and VALUES[key].of != "needle":  # no column states it
            draft.values.setdefault(key, f"{text} {unit}".strip())
        elif key not in (*VALUES, *NAMED_BY_LAYER):
            draft.unused.append((f"row {header} = {text}", Path(grid.where).name))
        elif key not in draft.values:
            rows.setdefault(key, []).append(header)
            columns[key] = {"column": rows[key], "unit": unit or name.unit}
    if columns:
        draft.add(keys | {"columns": columns}, grid.path)


def _draft_grid(grid: Table, keys: Keys, draft: Draft) -> None:
    if not any(map(any, grid.rows)):
        draft.unused.append((f"sheet {grid.sheet}" if grid.sheet else f"file {grid.path.name}", "empty"))
        return
    if pair := next((row for row in grid.rows if any(map(_PAIR.search, row))), None):
        raise DataError(
            f"a cell holds a number and its deviation: {' '.join(pair)[:80]}",
            expected="one number in each cell",
            fix="write deviations in a column of their own, SD",
            where=grid.where,
        )
    if _states_values(grid):
        is_head = any(find_meaning("heading", text) for text in grid.rows[0])
        keys |= {"layout": "pairs", "holds": "facts", "of": "all", "header_rows": [1] if is_head else []}
        _draft_values(grid, keys, draft)
        return
    keys = propose_layout(grid, keys | draft.table_keys)
    table = lay_out(grid, check({"holds": "facts"} | keys, TableRecord, grid.path))
    draft_entries(table, keys, draft)


# ---- entries of a table


def draft_entries(table: Table, keys: Keys, draft: Draft) -> None:
    """Add the entries of a table to a draft; without an entry, why nothing of it is read."""
    columns = TableDraft(table, keys, draft)
    draft.unused += [(line, table.path.name) for line in table.unread]
    if columns.name in columns.keys.get("unused", ()):
        draft.unused.append((f"table {columns.where}", "as stated"))
        return
    columns.take_columns()
    stated = columns.keys.get("holds", "")
    for kind in sorted(list_kinds(), key=lambda kind: kind.name != stated):
        if entries := kind.propose(columns, kind.name == stated):
            columns.keys["holds"] = kind.name
            _name_unused(columns, kind.has_points)
            for name, of_needle in entries.items():
                # the needle is shown first
                _add_entry(columns, kind, name, columns.taken | of_needle | columns.taken)
            return
    headers = ", ".join(filter(None, table.headers))[:200]
    problem = f"no column is known to hold coordinates: {headers or 'no headers'}"
    draft.unused.append((f"table {columns.where}", problem))
    if not OF_LAYERS & {column.meaning for column in columns.all}:
        names = [str(column.name) for column in columns.list_unknown()]
        draft.ignored[draft.names[table.path]] = names
    elif "boundaries" not in draft.values:
        columns.ask("table", name=columns.name, headers=headers)


def _name_unused(columns: TableDraft, has_points: bool) -> None:
    """Name columns that nothing uses; numbers under an unknown header are assumed to mean nothing.

    A person is asked about one of two directions, or of texts that may name needles.
    """
    for column in columns.list_free():
        texts = {*column.texts}
        are_sides = len(texts) == 2 and not any(
            list_bare_numbers(text) or read_side(text, "") is None for text in texts
        )
        are_names = has_points and 1 < len(texts) <= len(column.texts) / 2 and not columns.names
        is_needle = are_names and all(map(float.is_integer, column.numbers))
        if not column.is_known and (are_sides or is_needle):
            columns.ask_meaning(column, ["bevel_side", ""] if are_sides else ["needle", "bevel_side", ""], {})
    columns.draft.unused += [
        (f"column {column.name}", columns.where)
        for column in columns.all
        if column.place not in columns.used and column.texts and column.meaning not in ("unit", "pixel")
    ]
    names = [column.name for column in columns.list_unknown()]
    for name in names:
        columns.draft.assumed[f"unused.{name}"] = "not used: numbers under a header that is not known"
    if unused := [*columns.keys.get("unused", []), *names]:
        columns.keys["unused"] = unused


def _add_entry(columns: TableDraft, kind: RowKind, name: str, taken: Columns) -> None:
    """Add an entry of a needle, or of all, with units, words, labels of points, and what is left out."""
    draft, has_points, names = columns.draft, kind.has_points, columns.names
    records = {meaning: _spell(columns, meaning, places) for meaning, places in taken.items()}
    if name:
        records.setdefault("needle", {"value": name})
    for meaning, parts in draft.columns.items():
        beside = {key: part for key, part in parts.items() if key != "column"}
        is_whole = bool(beside.keys() & {"source", "value"})  # of needles, in place of a column
        if kind.placer if is_whole else meaning in records:
            records[meaning] = beside if is_whole else records[meaning] | beside
    for meaning, record in records.items():
        of_meaning, is_point = taken.get(meaning, ()), meaning in COORDINATES and has_points
        _add_unit(columns, meaning, record, of_meaning, is_point)
        if meaning == "bevel_side" and "bevel_side" not in draft.values:
            _ask_sides(columns, record, of_meaning)
    kind.complete(columns, records)
    if has_points:
        draft.curves.update(names or [name or columns.table.name])
    if has_points and names and "pattern" not in records.get("needle", {"pattern": ""}):
        statistics = sorted({name for name in names if find_meaning("statistic", name)})
        if statistics and EXCLUDED not in records:  # rows in place of a needle
            words = dict.fromkeys(statistics, EXCLUDED)
            records[EXCLUDED] = {"column": records["needle"]["column"], "words": words}
            draft.assumed[EXCLUDED] = f"{', '.join(statistics)}: no needles"
        place = (draft.names[columns.table.path], columns.keys.get("sheet", ""))
        draft.needles.setdefault(place, set()).update(names)
    draft.add({**columns.keys, "columns": records}, columns.table.path)


def _add_unit(
    columns: TableDraft, meaning: str, record: Keys, taken: Sequence[Column], is_point: bool
) -> None:
    """Add a unit that the header does not state."""
    draft, table, usual = columns.draft, columns.table, MEANINGS[meaning].unit
    unit, is_pixel = draft.unit, record.get("unit") == "px"
    beside = {column.meaning: column.name for column in reversed(columns.all) if column.texts}
    is_free = (meaning in COORDINATES or is_pixel) and table.system is None
    is_step = any(map(str.isdigit, unit))  # of a pixel: no unit of lengths in mm
    has_unit = record.get("unit", "px") != "px"
    if unit and is_free and not (has_unit and (is_step or not is_point)):
        record["unit"] = unit  # of points also beside a header that states another one
    elif not has_unit and (is_pixel or meaning in "xyz") and "pixel" in beside:
        record.pop("unit", None)
        record["unit_column"] = beside["pixel"]
    elif usual in ("mm", "1/mm", "GPa") and not record.keys() & {"unit", "unit_column"}:
        is_fact = usual == "1/mm" or (meaning in ATTRIBUTES and not is_point)
        is_bare = is_fact and any(list_bare_numbers(text) for column in taken for text in column.texts)
        unit = table.unit if usual == "mm" else ""
        if "unit" in beside:
            record["unit_column"] = beside["unit"]
            return
        if unit and (is_free or is_bare):
            record["unit"] = unit
        if is_bare:
            draft.assumed[f"{meaning}.unit"] = f"{unit or usual}: {join_columns(taken)} states no unit"


def _ask_sides(columns: TableDraft, record: Keys, taken: Sequence[Column]) -> None:
    """Ask which sides of bevels words or numbers mean that state none by themselves."""
    stated, unit = record.get("words", {}), record.get("unit", "")
    texts = dict.fromkeys(text for column in taken for text in column.texts)
    if not (unclear := [text for text in texts if text not in stated and read_side(text, unit) is None]):
        return
    answers = dict[str, dict[str, str]]()
    if all(columns.table.number(text) is not None for text in unclear):
        answers["degrees"] = {"bevel_side.unit": "deg"}
    for sides in permutations(("1", "-1")):
        words = dict(zip(unclear, sides, strict=False))
        answer = " ".join(f"{text}={side}" for text, side in words.items())
        answers[answer] = {"bevel_side.words": to_inline_table(words)}
    names = ", ".join(f"`{text}`" for text in unclear[:MAX_FLAGS])
    columns.ask("bevel_side", answers, names=names, name=record.get("column", ""))


def _spell(columns: TableDraft, meaning: str, taken: Sequence[Column]) -> Keys:
    """Return how a mapping names columns, and the unit of the first."""
    names, signs = [column.name for column in taken], {column.sign for column in taken}
    usual = "ras" if meaning in VECTORS and -1 in signs else ""
    spelled = {
        "column": names[0] if len(names) == 1 else names,
        "unit": taken[0].unit,
        "axes": "".join(column.axis for column in taken) if meaning == "guide" else usual,
        "sign": -1 if signs == {-1} and meaning not in columns.taken else 0,
        "words": dict.fromkeys(columns.excluded, EXCLUDED) if meaning == EXCLUDED else {},
    }
    return {key: value for key, value in spelled.items() if value}
