"""Join rows of tables of needles to the curves that they are about, by their names."""

import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence

from needlefit.datasets.columns import make_id
from needlefit.datasets.importing.answers import add_stated
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve, NeedleRow
from needlefit.errors import DataError
from needlefit.project.locate import join_names

MAX_NAME_CHARS = 60
MAX_LISTED_NAMES = 4  # of each side in a message


def join_needles(content: ImportContent) -> None:
    """Add to each curve what rows of tables of needles state of it; the names of curves are unique ids.

    Names are equal if their ids are, or, where that is unambiguous, their numbers: `1`, `1.0` and `01`.

    DataError if no row of a table is about any curve, or two rows contradict each other.
    """
    curves = {one.name: one for one in content.curves}
    found = _match_names({row.needle: None for row in content.needles}, curves)
    by_table = defaultdict[str, list[NeedleRow]](list)
    for row in content.needles:
        by_table[row.head].append(row)
    for rows in by_table.values():
        if not any(row.needle in found for row in rows):
            raise _refuse_table(rows, content.curves)
    named = {*found.values()}
    without_row = [name for name in curves if name not in named]
    for row in content.needles:
        if (name := found.get(row.needle)) is None:
            doubt = "no curve has its name"
            if without_row:
                doubt += f"; curves without a row: {join_names(without_row, MAX_LISTED_NAMES)}"
            content.leave_out(f"row of needle {row.needle}", row.where.rpartition("/")[2], doubt)
        else:
            _add_row(curves[name], row)
    content.renamed = {row: name for row, name in found.items() if _make_key(row) != _make_key(name)}


def _make_key(name: str) -> str:
    return make_id(name, name)[:MAX_NAME_CHARS].lower()


def _match_names(rows: Iterable[str], curves: Iterable[str]) -> dict[str, str]:
    """Return the name of the curve that each name in a row means, where there is one."""
    found: dict[str, str] = {}
    keys: tuple[Callable[[str], str], ...] = (_make_key, _read_numbers)
    for make_key in keys:
        free = [name for name in curves if name not in found.values()]
        left = [name for name in rows if name not in found]
        of_curves, spellings = Counter(map(make_key, free)), defaultdict[str, set[str]](set)
        for name in left:
            spellings[make_key(name)].add(_make_key(name))
        for row, curve in itertools.product(left, free):
            key = make_key(row)
            if key == make_key(curve) and of_curves[key] == 1 == len(spellings[key]):
                found[row] = curve
    return found


def _read_numbers(name: str) -> str:
    """Return a name without zeros that change no number: 1 for `1.0` and `01`, n1 for `n01`; not 1.10."""
    whole = re.sub(r"^(\d+)\.0+$", r"\1", _make_key(name))
    return re.sub(r"(?<![\d.])0+(?=\d)", "", whole)


def _refuse_table(rows: Sequence[NeedleRow], curves: Sequence[ImportedCurve]) -> DataError:
    names = join_names([*dict.fromkeys(row.needle for row in rows)], MAX_LISTED_NAMES)
    expected = f"names of the curves: {join_names([one.name for one in curves], MAX_LISTED_NAMES)}"
    return DataError(
        f"no curve has a name of this table: {names}",
        where=rows[0].where,
        expected=expected,
        fix="write the same names in both; or leave out this table, if it is about other needles",
    )


def _add_row(curve: ImportedCurve, row: NeedleRow) -> None:
    add_stated(curve.stated, row.stated)
    curve.turns += row.turns
    curve.sensors += row.sensors
    curve.are_sensors_from_base = row.are_sensors_from_base or curve.are_sensors_from_base
