"""Propose the entries of a mapping for one table: the kind of its rows, and columns, units and words."""

from collections.abc import Sequence
from itertools import permutations

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
from needlefit.datasets.importing.kinds import RowKind, list_kinds
from needlefit.datasets.importing.meanings import (
    ATTRIBUTES,
    COORDINATES,
    MEANINGS,
    Keys,
    find_meaning,
    is_side,
    list_bare_numbers,
    translate_side,
)
from needlefit.datasets.importing.tables import Table
from needlefit.schemas.mapping import POINT_ROWS


def draft_entries(table: Table, keys: Keys, draft: Draft) -> None:
    """Add the entries of a table to a draft; without an entry, why nothing of it is read."""
    columns = TableDraft(table, keys, draft)
    if columns.name in columns.keys.get("unused", ()):
        draft.unused.append((f"table {columns.where}", "as stated"))
        return
    columns.take_columns()
    stated = columns.keys.get("holds", "")
    for kind in sorted(list_kinds(), key=lambda kind: kind.name != stated):
        if entries := kind.propose(columns, kind.name == stated):
            columns.keys["holds"] = kind.name
            _name_unused(columns)
            for name, of_needle in entries.items():
                # the needle is shown first
                _add_entry(columns, kind, name, columns.taken | of_needle | columns.taken)
            return
    headers = ", ".join(filter(None, table.headers))[:200]
    problem = f"no column is known to hold coordinates: {headers or 'no headers'}"
    draft.unused.append((f"table {columns.where}", problem))
    if not OF_LAYERS & {column.meaning for column in columns.all}:
        draft.ignored[draft.names[table.path]] = problem
    elif "boundaries" not in draft.values:
        columns.ask("table", name=columns.name, headers=headers)


def _name_unused(columns: TableDraft) -> None:
    """Name columns that nothing uses; numbers under an unknown header are assumed to mean nothing.

    Of a column of two directions under an unknown header a person is asked.
    """
    for column in columns.list_free():
        texts = {*column.texts}
        are_sides = len(texts) == 2 and all(translate_side(text, "") != text for text in texts)
        if are_sides and not column.is_known:
            columns.ask_meaning(column, ["bevel_side", ""], {})
    columns.draft.unused += [
        (f"column {column.name}", columns.where)
        for column in columns.all
        if column.place not in columns.used and column.texts and column.meaning != "unit"
    ]
    names = [column.name for column in columns.list_unknown()]
    for name in names:
        columns.draft.assumed[f"unused.{name}"] = "not used: numbers under a header that is not known"
    if unused := [*columns.keys.get("unused", []), *names]:
        columns.keys["unused"] = unused


def _add_entry(columns: TableDraft, kind: RowKind, name: str, taken: Columns) -> None:
    """Add an entry of a needle, or of all, with units, words, labels of points, and what is left out."""
    draft, has_points, names = columns.draft, kind.name in POINT_ROWS, columns.names
    records = {meaning: _spell(columns, meaning, places) for meaning, places in taken.items()}
    if name:
        records.setdefault("needle", {"value": name})
    for meaning, parts in draft.columns.items():
        beside = {key: part for key, part in parts.items() if key != "column"}
        if meaning in records or (beside.keys() & {"source", "value"} and kind.placer):
            records[meaning] = records.get(meaning, {}) | beside
    for meaning, record in records.items():
        of_meaning, is_point = taken.get(meaning, ()), meaning in COORDINATES and has_points
        _add_unit(columns, meaning, record, of_meaning, is_point)
        if meaning == "bevel_side" and "bevel_side" not in draft.values:
            _ask_sides(columns, record, of_meaning)
    kind.complete(columns, records)
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
    unit, is_free = draft.unit, meaning in COORDINATES and table.system is None
    is_step = any(map(str.isdigit, unit))  # of a pixel: no unit of lengths in mm
    has_unit = record.get("unit", "px") != "px"
    if unit and is_free and not (has_unit and (is_step or not is_point)):
        record["unit"] = unit  # of points also beside a header that states another one
    elif usual in ("mm", "1/mm", "GPa") and not record.keys() & {"unit", "unit_column"}:
        is_fact = usual == "1/mm" or (meaning in ATTRIBUTES and not is_point)
        is_bare = is_fact and any(list_bare_numbers(text) for column in taken for text in column.texts)
        unit = table.unit if usual == "mm" else ""
        units = [column.name for column in columns.all if column.meaning == "unit" and column.texts]
        if units:
            record["unit_column"] = units[0]
            return
        if unit and (is_free or is_bare):
            record["unit"] = unit
        if is_bare:
            draft.assumed[f"{meaning}.unit"] = f"{unit or usual}: {join_columns(taken)} states no unit"


def _ask_sides(columns: TableDraft, record: Keys, taken: Sequence[Column]) -> None:
    """Ask which sides of bevels words or numbers mean that state none by themselves."""
    stated, unit = record.get("words", {}), record.get("unit", "")
    texts = dict.fromkeys(text for column in taken for text in column.texts)
    if not (unclear := [text for text in texts if text not in stated and not is_side(text, unit)]):
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
    names = [column.name for column in taken]
    spelled = {
        "column": names[0] if len(names) == 1 else names,
        "unit": taken[0].unit,
        "axes": "".join(column.axis for column in taken) if meaning == "guide" else "",
        "sign": 0 if meaning in columns.taken else columns.signs.get(meaning, 0),
        "words": dict.fromkeys(columns.excluded, EXCLUDED) if meaning == EXCLUDED else {},
    }
    return {key: value for key, value in spelled.items() if value}
