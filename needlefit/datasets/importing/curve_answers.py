"""Settle what is asked of every imported curve: an answer of each, and the sides of their bevels."""

from dataclasses import replace
from typing import Any

from needlefit.datasets.importing.answers import Answers, Stated
from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.directions import to_sides
from needlefit.errors import refusal


class CurveAnswers:
    """The curves of an import, and the answers to what is asked of each."""

    def __init__(self, curves: list[ImportedCurve], answers: Answers) -> None:
        self.curves = curves
        self.answers, self.settle, self.keep = answers, answers.settle, answers.keep

    def each(self, what: str, **options: Any) -> list[Stated]:  # noqa: ANN401 - those of `Answers.settle`
        """Return the answer of each needle to a question, in their order."""
        own = {one.name: one.stated for one in self.curves}
        return [*self.answers.settle_each(what, own, **options).values()]

    def settle_sides(self) -> list[float] | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        DataError if a cell is not understood.
        """
        self.settle_bevel_angle()
        return [cell.to_angle() for cell in self.each("bevel side")] if self.has_sides else None

    def settle_flat_sides(self, fix: str) -> list[int]:
        """Return the side of each bevel, of needles of which no shape was measured.

        DataError, with a `fix`, if bevels face several planes, or were turned.
        """
        angles = self.settle_sides()
        if angles is None:
            self.keep("bevel side", "1", "not stated", "assumption")
        sides, turns = to_sides(angles or [0.0] * len(self.curves))
        if any(turns) or any(one.turns or (one.sensors and len(one.line) > 1) for one in self.curves):
            what, where = "bevels are at right angles, turned, or beside curvatures", self.curves[0].points
            raise refusal(f"""{what}
                expected: sides 1 and -1, without shapes
                fix: {fix}
                where: {where.where()}""")
        return sides

    @property
    def has_sides(self) -> bool:
        """Whether the sides of bevels are stated."""
        return any("bevel side" in one for one in (self.answers.stated, *(one.stated for one in self.curves)))

    def settle_bevel_angle(self) -> None:
        """Take bevel angles as rolls, or leave them out: papers call the angle of the cut so, too."""
        angles = {one.name: one.stated["bevel angle"] for one in self.curves if "bevel angle" in one.stated}
        if not angles:
            return
        texts = ", ".join(dict.fromkeys(one.text for one in angles.values()))
        if self.has_sides and "bevel angle" not in self.answers.stated:
            self.keep("bevel angle", "cut", f"{texts}: where the bevel faces is stated beside it")
        elif self.settle("bevel angle", "", f"it is {texts}", choices=("roll", "cut")).text == "roll":
            for one in self.curves:
                if cell := angles.get(one.name):
                    one.stated["bevel side"] = replace(cell, unit=cell.unit or "deg")
