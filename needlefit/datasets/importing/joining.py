"""Join rows of tables of needles to the curves that they are about, by their names."""

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Collection, Container, Iterable, Sequence

from needlefit.datasets.columns import make_id
from needlefit.datasets.importing.answers import add_stated
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve, NeedleRow
from needlefit.datasets.importing.tables import CellTable
from needlefit.errors import DataError, refusal
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
    without_row = join_names([name for name in curves if name not in named], MAX_LISTED_NAMES)
    doubt = "no curve has its name" + (f"; curves without a row: {without_row}" if without_row else "")
    for row in content.needles:
        if (name := found.get(row.needle)) is None:
            content.leave_out(f"row of needle {row.needle}", row.where.rpartition("/")[2], doubt)
        else:
            curve = curves[name]
            add_stated(curve.stated, row.stated)
            curve.turns += row.turns
            curve.sensors += row.sensors
            curve.are_sensors_from_base |= row.are_sensors_from_base
    content.renamed = {row: name for row, name in found.items() if _make_key(row) != _make_key(name)}
    _doubt_left_out(content, curves)


def make_unique(name: str, taken: Container[str]) -> str:
    """Return a name, numbered from 2 where it is taken."""
    numbered = (f"{name}-{count}" for count in itertools.count(2))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)


def _doubt_left_out(content: ImportContent, curves: Collection[str]) -> None:
    """Doubt that a table without known headers, of which `--columns` states none, is to be left out."""
    for place, table in content.left_out.items():
        is_stated = any(text in content.columns for row in table.rows for text in row)
        if not is_stated and _names_needles(table, curves):
            content.doubts[place] = (
                "it names needles: state what its columns are with --columns MEANING=HEADER"
            )


def _make_key(name: str) -> str:
    return make_id(name, name)[:MAX_NAME_CHARS].lower()


def _match_names(rows: Iterable[str], curves: Iterable[str]) -> dict[str, str]:
    """Return the name of the curve that each name in a row means, where there is one."""
    found: dict[str, str] = {}
    keys: tuple[Callable[[str], str], ...] = (_make_key, _read_numbers)
    for make_key in keys:
        taken = {*found.values()}
        free = [name for name in curves if name not in taken]
        left = [name for name in rows if name not in found]
        of_curves, spellings = defaultdict[str, list[str]](list), defaultdict[str, set[str]](set)
        for name in free:
            of_curves[make_key(name)].append(name)
        for name in left:
            spellings[make_key(name)].add(_make_key(name))
        for name in left:
            same = of_curves.get(key := make_key(name), [])
            if len(same) == 1 == len(spellings[key]):
                found[name] = same[0]
    return found


def _names_needles(table: CellTable, curves: Collection[str]) -> bool:
    """Whether each cell of a column, below its header, names a curve, and two of them or more do."""
    # without numbers and known headers nothing states by what the cells of a text are separated
    rows = [re.split("[,;\t]", row[0]) if len(row) == 1 else row for row in table.rows]
    for column in itertools.zip_longest(*rows, fillvalue=""):
        _, *names = [*filter(None, column)] or [""]
        names = [*dict.fromkeys(names)]
        if 1 < len(names) <= len(curves) and len(_match_names(names, curves)) == len(names):
            return True
    return False


def _read_numbers(name: str) -> str:
    """Return a name without zeros that change no number: 1 for `1.0` and `01`, n1 for `n01`; not 1.10."""
    whole = re.sub(r"^(\d+)\.0+$", r"\1", _make_key(name))
    return re.sub(r"(?<![\d.])0+(?=\d)", "", whole)


def _refuse_table(rows: Sequence[NeedleRow], curves: Sequence[ImportedCurve]) -> DataError:
    names = join_names([*dict.fromkeys(row.needle for row in rows)], MAX_LISTED_NAMES)
    return refusal(f"""no curve has a name of this table: {names}
        expected: names of the curves:
            {join_names([one.name for one in curves], MAX_LISTED_NAMES)}
        fix: write the same names in both; or leave out this table, if it is about other needles
        where: {rows[0].where}""")
