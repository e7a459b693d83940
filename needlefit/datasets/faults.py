"""Faults found in a dataset: errors that are noted, so that one run lists them all, and not raised.

A fault states the file, and the line if it is known, what was expected there, and how to fix it.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from needlefit.errors import DataError, NeedlefitError

Fault = NeedlefitError  # one that is noted

MAX_LIKE_FAULTS = 3  # largest number of faults of one kind that are listed one by one
MAX_LISTED_PLACES = 5  # number of places that are listed where there are more faults
# pattern of the place behind a file's name
_PLACE = re.compile(r"(?::(?=\d)|, (?=(?:line|point|row|sheet) ))(?P<place>[^/]*)$")


def note_fault(faults: list[Fault], where: str | Path, problem: str, expected: str, fix: str) -> None:
    """Note what is wrong at a place, what is expected there, and how it is fixed."""
    faults.append(DataError(problem, expected=expected, fix=fix, where=where))


def merge_like(faults: Sequence[Fault]) -> list[Fault]:
    """Return faults with many of one kind in one file as one: the first, a count, and places of others.

    They are of one kind if the same is expected, and fixes them.
    """
    groups: dict[tuple[str, ...], list[Fault]] = {}
    for n, fault in enumerate(faults):
        kind = (fault.expected, fault.fix) if fault.expected or fault.fix else (str(n),)
        groups.setdefault((_PLACE.sub("", fault.where), *kind), []).append(fault)
    return [fault for group in groups.values() for fault in _merge(group)]


def _merge(group: Sequence[Fault]) -> Sequence[Fault]:
    if len(group) <= MAX_LIKE_FAULTS:
        return group
    first, *others = group
    places = [match["place"] for other in others if (match := _PLACE.search(other.where))]
    is_placed = len({*places}) == len(others)
    listed = (places if is_placed else [other.what for other in others])[:MAX_LISTED_PLACES]
    if is_placed and all(place.isdecimal() for place in listed):
        listed[0] = f"lines {listed[0]}"
    more = ", ..." if len(others) > len(listed) else ""
    return [
        first.replace(what=f"{first.what}; and {len(others)} more of this kind: {', '.join(listed)}{more}")
    ]


def as_error(faults: Sequence[Fault], path: Path) -> DataError:
    """Return one error that lists all faults found in `path`."""
    merged = merge_like(faults)
    if len(merged) == 1:
        return DataError(**vars(merged[0]))
    listed = "\n".join(str(fault) for fault in merged)
    return DataError(f"has {len(faults)} faults\n{listed}", where=path)
