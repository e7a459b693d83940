"""Settle what is asked of every imported curve: an answer of each, and the sides of their bevels."""

from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.directions import to_sides
from needlefit.datasets.importing.stated import Settler, Stated
from needlefit.errors import DataError


class CurveAnswers:
    """The curves of an import, and what holds of each."""

    def __init__(self, curves: list[ImportedCurve], settler: Settler) -> None:
        self.curves, self.settler, self.settle = curves, settler, settler.settle

    def each(
        self, key: str, usual: str | None = None, reason: str = "", is_sure: bool = False
    ) -> list[Stated]:
        """Return what holds of each needle, in their order."""
        stated = {curve.name: curve.stated for curve in self.curves}
        return [*self.settler.settle_each(key, stated, usual, reason, is_sure).values()]

    def stated(self, key: str) -> Stated | None:
        """Return what the mapping states of all needles; None if nothing."""
        return Stated(self.settler.values[key]) if key in self.settler.values else None

    def is_stated(self, key: str) -> bool:
        """Return whether the mapping or the cells of a needle state a key."""
        return self.stated(key) is not None or any(key in curve.stated for curve in self.curves)

    def settle_sides(self) -> list[float] | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        DataError if a cell is not understood.
        """
        if not self.is_stated("bevel_side"):
            return None
        return [cell.to_angle() for cell in self.each("bevel_side")]

    def settle_flat_sides(self, fix: str) -> list[int]:
        """Return the side of each bevel, of needles of which no shape was measured.

        DataError, with a `fix`, if bevels face several planes, or were turned.
        """
        angles = self.settle_sides()
        if angles is None:
            angles = [self.settle("bevel_side", "1", "not stated").to_angle()] * len(self.curves)
        sides, turns = to_sides(angles)
        if any(turns) or any(curve.turns or (curve.sensors and len(curve.line) > 1) for curve in self.curves):
            raise DataError(
                "bevels are at right angles, turned, or beside curvatures",
                expected="sides 1 and -1, without shapes",
                fix=fix,
                where=self.curves[0].points.where(),
            )
        return sides
