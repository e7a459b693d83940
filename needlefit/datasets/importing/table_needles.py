"""Read tables without coordinates: what they state of all needles, of each, of turns and of curvatures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from needlefit.arrays import Floats
from needlefit.datasets.columns import TURN_COLUMNS
from needlefit.datasets.importing.answers import Stated, add_stated
from needlefit.datasets.importing.curves import ATTRIBUTES, ImportContent, NeedleRow
from needlefit.datasets.importing.synonyms import UNITS_MM, read_header
from needlefit.datasets.importing.table_heads import (
    COLUMNS_FIX,
    ColumnGroup,
    apply_columns,
    find_pairs,
    find_units,
)
from needlefit.datasets.importing.table_statements import read_attributes, read_numbers
from needlefit.datasets.importing.tables import CellTable, UnclearColumnsError
from needlefit.errors import refusal

SENSOR = ("sensor", "curvature y", "curvature z", "curvature sd")  # what a row of curvatures states
MAX_LISTED_CHARS = 200  # of headers, or of a row, in a message


def read_shared(cells: CellTable, content: ImportContent) -> bool:
    """Add what a table without coordinates and without names of needles states of all needles.

    Its rows are pairs of a name and a value, or one row of values below headers. Return whether it does.
    """
    heads = [[read_header(text) for text in row] for row in cells.rows]
    if any(one.meaning == "needle" for row in heads for one in row):
        return False
    rows = [n for n in range(len(heads)) if cells.filled(n)]
    named = [n for n in rows if find_pairs(cells, n)]
    stated: dict[str, Stated] = {}
    if len(rows) == 2 and not named:
        group = ColumnGroup(rows[0], apply_columns(heads[rows[0]], content), range(len(heads[rows[0]])))
        stated = read_attributes(cells, group, rows[1:])
        cells.use(rows[0], *range(len(heads[rows[0]])))
    for n in named:
        for places, header, text in find_pairs(cells, n):
            add_stated(stated, {header.meaning: Stated(text, header.unit, cells.where(n, places[-1]))})
            cells.use(n, *places)
    stated.pop("depth", None)  # which no needles share
    add_stated(content.setup, stated)
    return bool(stated)


def read_needles(cells: CellTable, content: ImportContent) -> ColumnGroup:
    """Add what a table without coordinates states of needles, their turns or curvatures; return its columns.

    UnclearColumnsError if it names no needles.
    """
    for n, row in enumerate(cells.rows):
        group = ColumnGroup(n, apply_columns([read_header(text) for text in row], content), range(len(row)))
        if keys := group.find("needle") if group.find(*ATTRIBUTES, "exclusion", *SENSOR[1:3]) else []:
            break
    else:
        texts = dict.fromkeys(text for row in cells.rows[:6] for text in row)
        names = ", ".join(text for text in texts if text and cells.number(text) is None)
        raise UnclearColumnsError.of(f"""no header names coordinates: {names[:MAX_LISTED_CHARS]}
            expected: columns called x, y, z, or depth and deflection
            fix: {COLUMNS_FIX}
            where: {cells.where(0)}""")
    units = find_units(cells, n + 1)
    cells.use(n, *range(len(row)))
    cells.use(n + 1, *units)
    depth = group.find("turn depth") or (group.find("depth") if {*TURN_COLUMNS[1:]} <= {*row} else [])
    sensor = _find_sensors(cells, group)
    for m in range(n + 1 + bool(units), len(cells.rows)):
        if name := cells.cell(m, keys[0]):
            cells.use(m, keys[0])
            others = replace(group, columns=tuple(sensor))
            stated = read_attributes(cells, others, [m])
            sensors = [_read_lengths(cells, group, m, sensor)] if sensor else []
            turns = [float(one) for one in _read_lengths(cells, group, m, depth)]
            rolls = [stated.pop("bevel side", Stated("", "", cells.where(m))) for _ in turns]
            stated = {} if turns else stated  # its depth is that of the turn
            from_base = bool(sensor) and group.headers[sensor[0]].meaning == "sensor from base"
            pairs = [*zip(turns, rolls, strict=True)]
            where, head = cells.where(m, keys[0]), cells.where(n)
            content.needles.append(NeedleRow(name, where, head, stated, pairs, sensors, from_base))
        elif known := [cells.cell(m, k) for k in group.find(*ATTRIBUTES) if cells.cell(m, k)]:
            what, where = f"row {', '.join(known)}"[:MAX_LISTED_CHARS], Path(cells.where(m)).name
            content.leave_out(what, where, "it names no needle: fill in its name")
            cells.use(m, *cells.filled(m))
    return group


def _find_sensors(cells: CellTable, group: ColumnGroup) -> list[int]:
    """Return the columns of a table of curvatures in the order of `SENSOR`; none if it is no such table.

    DataError if it lacks one.
    """
    if not group.find(*SENSOR[1:3]):
        return []
    words = {SENSOR[0]: (SENSOR[0], "sensor from base"), SENSOR[3]: (SENSOR[3], "point sd")}
    found = {one: [m for word in words.get(one, (one,)) for m in group.find(word)] for one in SENSOR}
    if lacking := [one for one, columns in found.items() if not columns]:
        raise refusal(f"""a table of curvatures lacks {", ".join(lacking)}
            expected: columns s (from the tip, or from the base), kappa_y, kappa_z and sd
            fix: name them with --columns {",".join(f'"{one}=HEADER"' for one in lacking)}
            where: {cells.where(group.row)}""")
    return [columns[0] for columns in found.values()]


def _read_lengths(cells: CellTable, group: ColumnGroup, n: int, columns: Sequence[int]) -> Floats:
    """Return cells of a row in mm, curvatures in 1/mm; DataError if one or its unit is unknown."""
    values = read_numbers(cells, [n], columns)[0]
    for k, m in enumerate(columns):
        header = group.headers[m]
        if (unit := header.unit.removeprefix("1/").strip() or "mm") not in UNITS_MM:
            raise refusal(f"""the unit of {header.text} is {header.unit!r}
                expected: {", ".join(UNITS_MM)}
                fix: correct the header
                where: {cells.where(group.row, m)}""")
        is_place = header.meaning in ("sensor", "sensor from base", "depth", "turn depth")
        values[k] *= UNITS_MM[unit] ** (1 if is_place else -1)
    return values
