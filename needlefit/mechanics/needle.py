"""The needle as an inextensible Euler-Bernoulli beam, and checks of parameters."""

import math
from dataclasses import dataclass
from typing import Self

from needlefit.errors import ModelError
from needlefit.project.result_warnings import issue_warnings
from needlefit.project.unit_warnings import doubt_modulus, doubt_sizes, warn
from needlefit.schemas.limits import MAX_NEEDLE_DIAMETER_MM, MAX_NEEDLE_LENGTH_MM, MAX_NUMBER
from needlefit.schemas.scene import NeedleRecord

DEFAULT_DIAMETER_MM = 1.27  #: diameter (mm) of a drawn needle where none is stated: 18 gauge

#: smallest Young's modulus of a needle (MPa): polymers have 1000 to 5000; a smaller number is one in GPa
MIN_MODULUS_MPA = 500.0
MAX_MODULUS_MPA = 1e6  #: largest Young's modulus of a needle (MPa): a larger number is one in Pa


def is_bounded(*values: float) -> bool:
    """Return whether all values are numbers of at most `MAX_NUMBER`; False for anything else."""
    try:
        return all(abs(value) <= MAX_NUMBER for value in values)
    except (TypeError, OverflowError):
        return False


def require_type(name: str, value: object, kind: type) -> None:
    """Raise ModelError unless an argument is of its type."""
    if not isinstance(value, kind):
        raise ModelError(f"{name} is {value!r:.60}", expected=f"a {kind.__name__}")


def compute_rigidity(outer_diameter: float, youngs_modulus: float, inner_diameter: float = 0.0) -> float:
    """Return EI, N mm^2, of a round tube; diameters in mm, the modulus in MPa."""
    given = (outer_diameter, youngs_modulus, inner_diameter)
    if not is_bounded(*given) or not 0 <= inner_diameter < outer_diameter <= MAX_NEEDLE_DIAMETER_MM:
        raise ModelError(
            f"outer diameter, Young's modulus and inner diameter of the needle are {given} (mm, MPa, mm)",
            expected=f"0 <= inner < outer <= {MAX_NEEDLE_DIAMETER_MM:g} mm, and a finite modulus",
        )
    return youngs_modulus * (math.pi * (outer_diameter**4 - inner_diameter**4) / 64)


@dataclass(frozen=True)
class Needle:
    """A needle: a straight beam, free of load when straight.

    `length` is in mm, `flexural_rigidity` in N mm^2.
    """

    length: float  #: from base to tip, mm
    flexural_rigidity: float  #: EI, N mm^2
    outer_diameter: float | None = None  #: mm, where it is known: to draw the needle
    name: str = ""  #: by which tables name it

    def __post_init__(self) -> None:
        for name in ("length", "flexural_rigidity"):
            value = getattr(self, name)
            if not (is_bounded(value) and value > 0):
                raise ModelError(f"needle {name} is {value}", expected="a positive, finite number")
            object.__setattr__(self, name, float(value))  # the kernel reads no whole numbers
        if self.length > MAX_NEEDLE_LENGTH_MM:
            raise ModelError(
                f"needle length is {self.length:g} mm", expected=f"at most {MAX_NEEDLE_LENGTH_MM:g} mm"
            )

    @classmethod
    def from_tube(
        cls, length: float, outer_diameter: float, youngs_modulus: float, inner_diameter: float = 0.0
    ) -> Self:
        """Return the needle made of a round tube: EI = E pi (OD^4 - ID^4) / 64; lengths in mm, E in MPa."""
        if is_bounded(youngs_modulus) and not MIN_MODULUS_MPA <= youngs_modulus <= MAX_MODULUS_MPA:
            problem = f"Young's modulus of the needle is {youngs_modulus:g} MPa"
            expected = f"{MIN_MODULUS_MPA:g} to {MAX_MODULUS_MPA:g}; 200 GPa are 2e5 MPa"
            raise ModelError(problem, expected=expected)
        rigidity = compute_rigidity(outer_diameter, youngs_modulus, inner_diameter)
        sizes = {"length": length, "outer_diameter": outer_diameter, "inner_diameter": inner_diameter}
        doubts = (*doubt_sizes(sizes), *doubt_modulus(youngs_modulus * 1e-3, "youngs_modulus"))
        issue_warnings(warn(doubts, str))
        return cls(length, rigidity, outer_diameter)

    @classmethod
    def from_record(cls, record: NeedleRecord) -> Self:
        """Return the needle that a validated record describes."""
        outer, rigidity = record.outer_diameter_mm, record.flexural_rigidity_nmm2
        if rigidity is None:
            assert outer is not None and record.youngs_modulus_gpa is not None
            rigidity = compute_rigidity(outer, record.youngs_modulus_gpa * 1e3, record.inner_diameter_mm)
        return cls(record.length_mm, rigidity, outer, record.name)
