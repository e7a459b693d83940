"""Extract the loading of each specimen from its rows, and report faults and corrections."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.faults import Fault

MIN_STRETCHES = 6
"""Least number of different stretches of a loading: two of them determine mu and alpha."""

STRETCH_TOLERANCE = 2e-3
"""An unloaded stretch may differ from 1 by this: the zero of a testing machine is not exact."""

MIN_TURN_FRACTION = 0.05
"""A movement back by more than this fraction of the whole range is a reversal of the machine, not noise."""

MIN_PRELOAD_FRACTION = 0.03
"""A stress at stretch 1 above this part of the largest is reported: it biases mu and alpha."""

MAX_OPPOSITE_FRACTION = 0.05
"""Stresses of the other sign above this fraction of the largest are not noise around zero."""


def find_stretch_faults(stretch: Floats, stress: Floats, where: str, name: str) -> Iterator[Fault]:
    """Yield the reasons why the numbers (N,) cannot be stretches of a compression test."""
    low, high = float(stretch.min()), float(stretch.max())
    here = f"stretch of specimen {name} goes from {low:g} to {high:g}"
    expected = "height now over height before: 1 unloaded, falling to e.g. 0.8"
    if high > 3:
        yield Fault(where, f"{here}: this looks like percent", expected, "divide the column by 100")
    elif _looks_like_strain(stretch, stress) and high < 1 + STRETCH_TOLERANCE:
        fix = "stretch = 1 - strain, where the strain is positive in compression"
        yield Fault(
            where, f"{here} and is about 0 where the stress is: this looks like strain", expected, fix
        )
    elif low <= 0:
        yield Fault(where, here, expected, "a height cannot reach 0: check height_mm, or the unit")
    elif low >= 1 - STRETCH_TOLERANCE and high <= 1 + STRETCH_TOLERANCE:
        yield Fault(
            where, f"{here}: it is hardly compressed", expected, "compress it further, or check the unit"
        )
    elif low >= 1 - STRETCH_TOLERANCE:
        fix = "measure in compression: the model's tissue is compressed only (stretch at most 1)"
        yield Fault(where, f"{here}: this is tension", expected, fix)
    elif high > 1 + STRETCH_TOLERANCE:
        fix = "keep the rows in compression; displacement_mm, if it is that, is positive toward the specimen"
        yield Fault(where, f"{here}: tension and compression in one test", expected, fix)


def find_stress_faults(stress: Floats, where: str, name: str) -> Iterator[Fault]:
    """Yield the reasons why the numbers (N,) cannot be stresses of one sign."""
    low, high = float(stress.min()), float(stress.max())
    largest = max(abs(low), abs(high))
    if largest == 0:
        yield Fault(
            where, f"stress of specimen {name} is 0 throughout", "a measured stress", "check the column"
        )
    elif min(abs(low), abs(high)) > MAX_OPPOSITE_FRACTION * largest and low < 0 < high:
        yield Fault(
            where,
            f"stress of specimen {name} goes from {low:.3g} to {high:.3g} MPa, through zero",
            "one sign: all positive or all negative in compression",
            "remove the offset of the load cell, or the rows in which the specimen is pulled",
        )


def find_turns(stretch: Floats) -> list[int]:
    """Return the rows at which the testing machine reverses; reversals within noise do not count."""
    wide = MIN_TURN_FRACTION * float(np.ptp(stretch))
    # -1: loading comes first, and stretch falls as the specimen is compressed.
    found, extreme, direction = [], 0, -1
    for n in range(1, len(stretch)):
        if direction * (stretch[n] - stretch[extreme]) > 0:
            extreme = n
        elif direction * (stretch[extreme] - stretch[n]) > wide:
            found.append(extreme)
            direction, extreme = -direction, n
    return found


def compute_lost_work(stretch: Floats, stress: Floats, turn: int) -> float:
    """Return the fraction of the loading work that the unloading after row `turn` does not return."""
    back = slice(turn, None)
    low, high = float(stretch[turn]), min(float(stretch[: turn + 1].max()), float(stretch[back].max()))
    at = np.linspace(low, high, 200)
    loading, unloading = (
        np.trapezoid(np.interp(at, *_sort_by_stretch(stretch[part], stress[part])), at)
        for part in (slice(0, turn + 1), back)
    )
    return float(1 - unloading / loading)


def estimate_preload(stretch: Floats, stress: Floats) -> float:
    """Return the stress at stretch 1 of a sorted loading (N,), as a fraction of its largest stress.

    It is read from a line through the first tenth; 0 for a loading that begins far from stretch 1.
    """
    first = max(MIN_STRETCHES, len(stretch) // 10)
    if abs(1 - stretch[0]) > STRETCH_TOLERANCE:
        return 0.0
    if np.ptp(stretch[:first]) == 0:  # the machine waited: there is no line through one stretch
        at_one = stress[:first].mean()
    else:
        _, at_one = np.polyfit(stretch[:first] - 1, stress[:first], 1)
    return float(at_one / np.max(np.abs(stress)))


def _sort_by_stretch(stretch: Floats, stress: Floats) -> tuple[Floats, Floats]:
    order = np.argsort(stretch, kind="stable")
    return stretch[order], stress[order]


def _looks_like_strain(stretch: Floats, stress: Floats) -> bool:
    """Say whether the `stretch` of the least stressed row is nearer to 0 than to 1."""
    rest = abs(float(stretch[int(np.argmin(np.abs(stress)))]))
    return rest < 0.5


MAX_LOADING_POINTS = 200
"""A longer loading is averaged over neighbouring rows, so that noise of single readings does not hide slower
errors."""


@dataclass(frozen=True)
class SpecimenLoading:
    """The loading of one specimen, from the largest stretch to the smallest.

    Attributes
    ----------
    stretch : (N,) array
        Falling.
    stress : (N,) array
        MPa, negative in compression.
    """

    name: str
    stretch: Floats
    stress: Floats


@dataclass(frozen=True)
class SpecimenRows:
    """The rows of one specimen as they are in the file: positions, stretch (N,), stress (N,) in MPa."""

    name: str
    where: list[str]
    stretch: Floats
    stress: Floats

    @property
    def end(self) -> int:
        """The row at which the loading ends; 0 where the table begins at the largest compression."""
        return (find_turns(self.stretch) or [len(self.stretch) - 1])[0]


def find_loading_faults(rows: SpecimenRows) -> list[Fault]:
    """Return why the rows are neither a loading, nor a loading and an unloading, in compression."""
    where, name = rows.where[0], rows.name
    if len(np.unique(rows.stretch)) < MIN_STRETCHES:
        what = f"specimen {name} has {len(np.unique(rows.stretch))} different stretches"
        return [
            Fault(
                where, what, f"at least {MIN_STRETCHES}", "give more of the curve, or leave the specimen out"
            )
        ]
    found = [*find_stretch_faults(rows.stretch, rows.stress, where, name)]
    found += find_stress_faults(rows.stress, where, name)
    at = find_turns(rows.stretch)
    if len(at) > 1:
        what = f"specimen {name} turns round {len(at)} times, first here"
        fix = "keep one loading (the last, if the first ones were to condition it), and sort scattered rows"
        found.append(Fault(rows.where[at[0]], what, "one loading, or a loading and its unloading", fix))
    elif 0 < rows.end < MIN_STRETCHES - 1:
        what = f"specimen {name} is loaded in {rows.end + 1} rows only, then it is unloaded"
        found.append(
            Fault(where, what, f"at least {MIN_STRETCHES} rows of loading", "give the rows of its loading")
        )
    return found


def extract_loading(rows: SpecimenRows) -> SpecimenLoading:
    """Return the loading alone: sorted, averaged to at most `MAX_LOADING_POINTS`, with negative stresses."""
    loading_rows = slice(0, rows.end + 1) if rows.end else slice(None)
    stretch, stress = rows.stretch[loading_rows], rows.stress[loading_rows]
    # Stable: rows with equal stretch keep the order of the file.
    order = np.argsort(-stretch, kind="stable")
    sign = -1.0 if stress.sum() > 0 else 1.0
    pieces = np.array_split(order, min(len(order), MAX_LOADING_POINTS))
    means = np.array([(np.mean(stretch[piece]), sign * np.mean(stress[piece])) for piece in pieces])  # (N, 2)
    return SpecimenLoading(rows.name, means[:, 0], means[:, 1])


def describe_readings(specimens: Sequence[SpecimenRows]) -> list[str]:
    """Return sentences on what was reversed or left out, and on what distorts the fit."""
    turn_notes = [sentence for rows in specimens for sentence in _describe_turn(rows)]
    preloaded = [sentence for rows in specimens for sentence in _describe_preload(extract_loading(rows))]
    long = [f"specimen {r.name}" for r in specimens if len(r.stretch) > MAX_LOADING_POINTS]
    averaged = (
        [f"{', '.join(long)}: neighbouring rows averaged to {MAX_LOADING_POINTS} points"] if long else []
    )
    return [*_describe_sign(specimens), *turn_notes, *averaged, *preloaded]


def _describe_sign(specimens: Sequence[SpecimenRows]) -> list[str]:
    positive = [rows.name for rows in specimens if rows.stress.sum() > 0]
    if not positive:
        return []
    which = "" if len(positive) == len(specimens) else f" of {', '.join(positive)}"
    return [f"the stresses{which} are positive in the file: read as compression"]


def _describe_turn(rows: SpecimenRows) -> list[str]:
    last = len(rows.stretch) - 1
    if rows.end == last:
        return []
    if rows.end == 0:
        return [f"specimen {rows.name} runs from its smallest stretch up: read as a loading all the same"]
    lost_fraction = compute_lost_work(rows.stretch, rows.stress, rows.end)
    return [
        f"specimen {rows.name} is unloaded from {rows.where[rows.end]} on and does not give back "
        f"{100 * lost_fraction:.0f} % of the work: only its loading is used; an elastic law knows no such "
        f"loss"
    ]


def _describe_preload(one: SpecimenLoading) -> list[str]:
    part = estimate_preload(one.stretch, one.stress)
    if abs(part) < MIN_PRELOAD_FRACTION:
        return []
    return [
        f"specimen {one.name} bears {100 * abs(part):.0f} % of its largest stress at stretch 1 already: "
        "take the preload or the cell's offset off, or let the stretch begin where the stress does"
    ]
