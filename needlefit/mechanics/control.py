"""What steers the needle (bevel, base, guide) and the rules by which it advances."""

import math
from dataclasses import dataclass
from typing import Self

from needlefit.errors import ModelError
from needlefit.project.records.scene import BevelRecord, ControlsRecord, RulesRecord


@dataclass(frozen=True)
class Bevel:
    """The bevel turns the cut by `offset` (mm) per constraint spacing, toward `side` (+1: y > 0, -1)."""

    offset: float
    side: int = 1

    def __post_init__(self) -> None:
        if not math.isfinite(self.offset) or self.side not in (1, -1):
            raise ModelError(
                f"bevel has offset {self.offset} mm, side {self.side}", expected="finite; +1 or -1"
            )

    @classmethod
    def from_record(cls, record: BevelRecord) -> Self:
        """Return the bevel that a checked record describes."""
        return cls(record.offset_mm, record.side)


@dataclass(frozen=True)
class Controls:
    """Essential conditions, constant over the insertion.

    Attributes
    ----------
    base_y, base_slope : float
        Deflection (mm) and slope of the base in C since contact.
    guide_distance : float or None
        A clamping guide this far (mm) before the entry, on the insertion axis; the shaft behind it
        carries nothing. None: the base alone holds the needle.
    """

    base_y: float = 0.0
    base_slope: float = 0.0
    guide_distance: float | None = None

    def __post_init__(self) -> None:
        if self.guide_distance is not None and (self.base_y or self.base_slope):
            raise ModelError(
                "a base moved behind a clamping guide does not reach the tissue",
                expected="base_y and base_slope 0 where there is a guide",
                mend="leave out the guide, or the base's motion",
            )
        if self.guide_distance is not None and not (
            math.isfinite(self.guide_distance) and self.guide_distance > 0
        ):
            raise ModelError(
                f"guide_distance is {self.guide_distance} mm", expected="a positive, finite number"
            )

    @classmethod
    def from_record(cls, record: ControlsRecord) -> Self:
        """Return the controls that a checked record describes (degrees become slopes)."""
        return cls(record.base_y_mm, math.tan(math.radians(record.base_slope_deg)), record.guide_distance_mm)


@dataclass(frozen=True)
class Rules:
    """What else decides the answer.

    Attributes
    ----------
    spacing : float
        Constraint spacing C_int, mm: part of the model, fits with different values are never compared.
    element : float
        Mesh size h, mm, a divisor of `spacing`: purely numerical.
    tolerance : float
        Newton stops when no node moves by more than this, mm.
    max_iterations : int
        A step that takes more has not converged.
    """

    spacing: float = 1.0
    element: float = 1.0
    tolerance: float = 1e-7
    max_iterations: int = 40

    def __post_init__(self) -> None:
        ratio = self.spacing / self.element if self.element > 0 else 0.0
        if not (self.spacing > 0 and round(ratio) >= 1 and math.isclose(ratio, round(ratio), rel_tol=1e-3)):
            raise ModelError(
                f"element size {self.element} mm does not divide the constraint spacing {self.spacing} mm",
                expected="element_mm = constraint_spacing_mm / 1, 2, 3, ... (to three digits)",
            )
        object.__setattr__(self, "element", self.spacing / round(ratio))  # 0.333 means a third

    @classmethod
    def from_record(cls, record: RulesRecord) -> Self:
        """Return the rules that a checked record describes."""
        return cls(record.constraint_spacing_mm, record.element_mm)
