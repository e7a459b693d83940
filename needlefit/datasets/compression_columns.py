"""The columns of a compression test: the ways to say stretch and stress, and which of them a table uses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.faults import Fault
from needlefit.datasets.formats.csv import Table, columns_there, numbers
from needlefit.mechanics.compression import MEASURES, Measure

Floats = NDArray[np.float64]

UNITS = {"pa": 1e-6, "kpa": 1e-3, "mpa": 1.0}
SPECIMEN = ("sample", "id")
SIZES = ("height_mm", "area_mm2", "diameter_mm")
"""What belongs to the specimen, not to a row: it may stand in the specimen's first row alone."""

STRETCH_WAYS = (("stretch",), ("displacement_mm", "height_mm"))
FORCE_WAYS = (("force_n", "area_mm2"), ("force_n", "diameter_mm"))
LARGEST_STRESS = 1e12

SAYS_STRETCH = "`stretch`, or `displacement_mm` (the way of the plate) with `height_mm`"
SAYS_STRESS = (
    "`nominal_stress_kpa` or `true_stress_kpa` (or _pa, _mpa), or `force_n` with `area_mm2` or `diameter_mm`"
)


@dataclass(frozen=True)
class Columns:
    """Which columns of a table hold what.

    Attributes
    ----------
    stretch, stress : tuple of str
        The columns each is made from.
    measure : "nominal" or "true"
        Of the stress.
    unit : float
        What the column of stresses is multiplied by to give MPa; 1 where force and area make it.
    sample : str
        Column that tells specimens apart; empty: all rows are one.
    """

    stretch: tuple[str, ...]
    stress: tuple[str, ...]
    measure: Measure
    unit: float
    sample: str


def find_columns(table: Table, stated: Measure | None, found: list[Fault]) -> Columns | None:
    """Return what the columns hold, or None after a fault; `stated` is the measure of a mere `stress_kpa`."""
    names, where = list(map(str, table.cells.columns)), f"{table.path}:1"
    stretch = _one_of([way for way in STRETCH_WAYS if set(way) <= set(names)], "the stretch", where, found)
    if stretch is None:
        _no_stretch(names, where, found)
    ways = [(f"{kind}stress_{unit}",) for kind in ("nominal_", "true_", "") for unit in UNITS]
    stress = _one_of(
        [way for way in (*ways, *FORCE_WAYS) if set(way) <= set(names)], "the stress", where, found
    )
    if stress is None:
        _no_stress(names, where, found)
    samples = [name for name in SPECIMEN if name in names]
    if not stretch or not stress:
        return None
    measure = _measure(stress[0], stated, where, found)
    unit = UNITS.get(stress[0].rpartition("_")[2], 1.0)
    return None if measure is None else Columns(stretch, stress, measure, unit, samples[0] if samples else "")


def specimens(table: Table, column: str) -> NDArray[np.str_]:
    """Return the specimen of each row (N,)."""
    if not column:
        return np.full(len(table.lines), table.path.stem)
    names: NDArray[np.str_] = table.cells[column].to_numpy(dtype=str)
    return names


def stretches(table: Table, columns: Columns, who: NDArray[np.str_], found: list[Fault]) -> Floats:
    """Return the stretch (N,); NaN where a cell is faulty."""
    if columns.stretch == ("stretch",):
        return numbers(table, "stretch", found)
    way = numbers(table, "displacement_mm", found)
    stretch: Floats = 1 - way / _size(table, "height_mm", who, found)
    return stretch


def stresses(table: Table, columns: Columns, who: NDArray[np.str_], found: list[Fault]) -> Floats:
    """Return the stress (N,), MPa, with the sign of the file; NaN where a cell is faulty."""
    values = numbers(table, columns.stress[0], found, largest=LARGEST_STRESS)
    if len(columns.stress) == 1:
        return values * columns.unit
    size = _size(table, columns.stress[1], who, found)
    return values / (size if columns.stress[1] == "area_mm2" else math.pi * size**2 / 4)


def _size(table: Table, column: str, who: NDArray[np.str_], found: list[Fault]) -> Floats:
    """Return a size of the specimen for each row (N,); NaN where it is not one number above 0."""
    given = numbers(table, column, found, optional=True)
    sizes = np.full(len(given), np.nan)
    for name in dict.fromkeys(who.tolist()):
        rows = np.flatnonzero(who == name)
        stated = np.unique(given[rows][np.isfinite(given[rows])])
        if len(stated) == 1 and stated[0] > 0:
            sizes[rows] = stated[0]
            continue
        said = ", ".join(f"{value:g}" for value in stated) or "nowhere"
        what = f"{column} of specimen {name} is {said}"
        fix = "give the size that it had before it was compressed, in its first row or in all of them"
        found.append(Fault(table.where(int(rows[0])), what, "one number above 0 for each specimen", fix))
    return sizes


def _one_of(
    ways: Sequence[tuple[str, ...]], what: str, where: str, found: list[Fault]
) -> tuple[str, ...] | None:
    """Return the only way; an empty one after a fault because there are several, None if there is none."""
    if len(ways) < 2:
        return ways[0] if ways else None
    listed = " and by ".join(f"`{'`, `'.join(way)}`" for way in ways)
    found.append(
        Fault(
            where, f"{what} is given by {listed}", "one of them", "remove the columns that shall not be used"
        )
    )
    return ()


def _no_stretch(names: list[str], where: str, found: list[Fault]) -> None:
    strains = [name for name in names if "strain" in name.lower()]
    fix = "name the column so, or add it"
    if strains:
        fix = f"add stretch = 1 - strain (in compression): `{strains[0]}` does not say its sign, or percent"
    found.append(Fault(where, _lacking("stretch", names), SAYS_STRETCH, fix))


def _no_stress(names: list[str], where: str, found: list[Fault]) -> None:
    near = [name for name in names if "stress" in name.lower() or "force" in name.lower()]
    fix = "name the column so, or add it"
    if near:
        fix = f"rename `{near[0]}`: its name must say the unit, and a force needs the specimen's area"
    found.append(Fault(where, _lacking("stress", names), SAYS_STRESS, fix))


def _lacking(what: str, names: list[str]) -> str:
    return f"no columns give the {what}; there are {columns_there(names)}"


def _measure(column: str, stated: Measure | None, where: str, found: list[Fault]) -> Measure | None:
    """Return the measure that the column states, or else the option; None after a fault."""
    said = next((kind for kind in MEASURES if column.startswith(f"{kind}_")), None)
    said = "nominal" if column == "force_n" else said  # over the area before, by the columns' meaning
    if said is None and stated is None:
        expected = "nominal (force over the area before compression) or true (over the area at that moment)"
        fix = f"rename it to nominal_{column} or true_{column}, or give --stress nominal|true"
        found.append(Fault(where, f"`{column}` does not say which stress it is", expected, fix))
    elif said is not None and stated not in (None, said):
        fix = "leave --stress out, or rename the column"
        what = f"`{column}` is the {said} stress, but --stress says {stated}"
        found.append(Fault(where, what, "one of the two", fix))
        return None
    return said or stated
