"""Settle what is asked of every imported curve: an answer of each, and the sides of their bevels."""

from collections import Counter

from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.stated import Settler, Stated, name_set
from needlefit.project.locate import join_names


class CurveAnswers:
    """The curves of an import, and what holds of each."""

    def __init__(self, curves: list[ImportedCurve], settler: Settler) -> None:
        self.curves, self.settler, self.settle = curves, settler, settler.settle
        counts = Counter(key for curve in curves for key in curve.stated)
        self.partly_stated = {key for key in counts if counts[key] < len(curves)}

    def each(
        self, key: str, usual: str | None = None, reason: str = "", is_sure: bool = False
    ) -> list[Stated]:
        """Return what holds of each needle: its own cell, else the value of all.

        A value that is stated beside cells of all needles of the import takes their place. DataError if
        nothing states it of some needles.
        """
        cells = {curve.name: curve.stated[key] for curve in self.curves if key in curve.stated}
        missing = [curve.name for curve in self.curves if curve.name not in cells]
        is_stated = key in self.settler.values and key not in self.partly_stated
        if not cells or (is_stated and not missing):
            return [self.settle(key, usual, reason, is_sure=is_sure)] * len(self.curves)
        rest = next(iter(cells.values()))
        if missing:
            reason = f"stated of {join_names([*cells], 5)}, not of {join_names(missing, 5)}"
            fix = f"fill in their cells, or state {name_set(key)} of all that are blank"
            rest = self.settle(key, "", reason, fix=fix, where=rest.where)
        return [cells.get(curve.name, rest) for curve in self.curves]

    def numbers(
        self, key: str, unit: str = "mm", is_above: bool = False, usual: str | None = None, reason: str = ""
    ) -> list[float]:
        """Return the number of each needle, in a unit."""
        return [answer.to_number(key, unit, is_above) for answer in self.each(key, usual, reason)]

    def stated(self, key: str) -> Stated | None:
        """Return what the mapping states of all needles; None if nothing."""
        return Stated(self.settler.values[key]) if key in self.settler.values else None

    def is_stated(self, key: str) -> bool:
        """Return whether the mapping or the cells of a needle state a key."""
        return self.stated(key) is not None or any(key in curve.stated for curve in self.curves)

    def settle_sides(self, is_needed: bool = False) -> list[float] | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        DataError if a cell is not understood. `is_needed`: what nobody states is assumed.
        """
        if not (is_needed or self.is_stated("bevel_side")):
            return None
        return [cell.to_angle() for cell in self.each("bevel_side", "1", "not stated")]
