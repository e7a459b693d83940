"""From the rows of one specimen to its loading, and what must be said of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.compression_faults import (
    FEWEST,
    PRELOAD,
    lost_work,
    preload,
    stress_faults,
    stretch_faults,
    turns,
)
from needlefit.datasets.faults import Fault

Floats = NDArray[np.float64]

MOST_POINTS = 200
"""A longer loading is averaged over neighbours: noise from reading to reading must not hide slower errors."""


@dataclass(frozen=True)
class Specimen:
    """The loading of one specimen, from the largest stretch to the smallest.

    Attributes
    ----------
    name : str
    stretch : (N,) array
        Falling.
    stress : (N,) array
        MPa, negative in compression.
    """

    name: str
    stretch: Floats
    stress: Floats


@dataclass(frozen=True)
class Record:
    """The rows of one specimen as they stand in the file: places, stretch (N,), stress (N,) in MPa."""

    name: str
    where: list[str]
    stretch: Floats
    stress: Floats

    @property
    def end(self) -> int:
        """The row at which the loading ends; 0 where the table runs from the deepest row up."""
        return (turns(self.stretch) or [len(self.stretch) - 1])[0]


def record_faults(record: Record) -> list[Fault]:
    """Return why the rows are no loading, or loading and unloading, in compression."""
    where, name = record.where[0], record.name
    if len(np.unique(record.stretch)) < FEWEST:
        what = f"specimen {name} has {len(np.unique(record.stretch))} different stretches"
        return [Fault(where, what, f"at least {FEWEST}", "give more of the curve, or leave the specimen out")]
    found = [*stretch_faults(record.stretch, record.stress, where, name)]
    found += stress_faults(record.stress, where, name)
    at = turns(record.stretch)
    if len(at) > 1:
        what = f"specimen {name} turns round {len(at)} times, first here"
        fix = "keep one loading (the last, if the first ones were to condition it), and sort scattered rows"
        found.append(Fault(record.where[at[0]], what, "one loading, or a loading and its unloading", fix))
    elif 0 < record.end < FEWEST - 1:
        what = f"specimen {name} is loaded in {record.end + 1} rows only, then it is unloaded"
        found.append(Fault(where, what, f"at least {FEWEST} rows of loading", "give the rows of its loading"))
    return found


def loading(record: Record) -> Specimen:
    """Return the loading alone, sorted, averaged to at most `MOST_POINTS`, its stresses negative."""
    kept = slice(0, record.end + 1) if record.end else slice(None)
    stretch, stress = record.stretch[kept], record.stress[kept]
    order = np.argsort(-stretch, kind="stable")
    sign = -1.0 if stress.sum() > 0 else 1.0
    pieces = np.array_split(order, min(len(order), MOST_POINTS))
    means = np.array([(np.mean(stretch[piece]), sign * np.mean(stress[piece])) for piece in pieces])  # (N, 2)
    return Specimen(record.name, means[:, 0], means[:, 1])


def remarks(records: Sequence[Record]) -> list[str]:
    """Return in sentences what was turned or left out, and what bends the fit."""
    turned = [said for record in records for said in _turn_said(record)]
    preloaded = [said for record in records for said in _preload_said(loading(record))]
    long = [f"specimen {r.name}" for r in records if len(r.stretch) > MOST_POINTS]
    averaged = [f"{', '.join(long)}: neighbouring rows averaged to {MOST_POINTS} points"] if long else []
    return [*_sign_said(records), *turned, *averaged, *preloaded]


def _sign_said(records: Sequence[Record]) -> list[str]:
    positive = [record.name for record in records if record.stress.sum() > 0]
    if not positive:
        return []
    which = "" if len(positive) == len(records) else f" of {', '.join(positive)}"
    return [f"the stresses{which} are positive in the file: read as compression"]


def _turn_said(record: Record) -> list[str]:
    last = len(record.stretch) - 1
    if record.end == last:
        return []
    if record.end == 0:
        return [f"specimen {record.name} runs from its smallest stretch up: read as a loading all the same"]
    lost = lost_work(record.stretch, record.stress, record.end)
    return [
        f"specimen {record.name} is unloaded from {record.where[record.end]} on and does not give back "
        f"{100 * lost:.0f} % of the work: only its loading is used; an elastic law knows no such loss"
    ]


def _preload_said(one: Specimen) -> list[str]:
    part = preload(one.stretch, one.stress)
    if abs(part) < PRELOAD:
        return []
    return [
        f"specimen {one.name} bears {100 * abs(part):.0f} % of its largest stress at stretch 1 already: "
        "take the preload or the cell's offset off, or let the stretch begin where the stress does"
    ]
