"""The inputs of an insertion (bevel, base, guides, tracked tip), its steps, and the options of the model."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self, get_args

from needlefit.errors import ModelError
from needlefit.mechanics.native import LINEAR_CUT, compute_sine_cosine
from needlefit.mechanics.needle import is_bounded, require_type
from needlefit.schemas.limits import (
    MAX_CONSTRAINT_SPACING_MM,
    MAX_GUIDES,
    MAX_ITERATIONS,
    MAX_NEEDLE_LENGTH_MM,
    MIN_ELEMENT_MM,
)
from needlefit.schemas.scene import Advance, BevelRecord, RulesRecord


@dataclass(frozen=True)
class Bevel:
    """The needle's bevel, which turns the cut toward `side` (+1: y > 0), or about x away from there.

    `offset` is in mm per constraint spacing, `cut_angle` in rad, `roll_deg` in degrees.
    """

    offset: float = 0.0  #: b of the advance along the tangent, mm per constraint spacing
    side: int = 1
    cut_angle: float = 0.0  #: theta of the advance by the path angle, rad: of the cut to the needle's tangent
    #: roll about x, right-handed, from the direction of `side`, degrees: 90 turns a bevel from +y to +z
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        if not is_bounded(self.offset, self.cut_angle, self.roll_deg) or self.side not in (1, -1):
            raise ModelError(
                f"bevel has offset {self.offset} mm, angle {self.cut_angle} rad, side {self.side}, roll "
                f"{self.roll_deg} degrees",
                expected="offset, angle and roll that are finite numbers, side +1 or -1",
            )

    @property
    def toward(self) -> tuple[float, float]:
        """The unit vector (y, z) toward which the bevel turns the cut; exact at whole quarter turns."""
        if self.roll_deg == 0:
            return float(self.side), 0.0
        quarters = math.floor(self.roll_deg / 90 + 0.5)
        rest = math.radians(self.roll_deg - 90 * quarters)
        z, y = (self.side * part for part in compute_sine_cosine(rest))
        return ((y, z), (-z, y), (-y, -z), (z, -y))[quarters % 4]

    @classmethod
    def from_record(cls, record: BevelRecord) -> Self:
        """Return the bevel that a validated record describes."""
        roll = record.roll_deg if record.roll_deg is not None else 0.0 if record.side > 0 else 180.0
        return cls.turn(roll, record.offset_mm or 0.0, math.radians(record.cut_angle_deg or 0.0))

    @classmethod
    def turn(cls, roll_deg: float, offset: float, cut_angle: float) -> Self:
        """Return a bevel with a roll from +y, degrees; rolled by half a turn it is that of the other side."""
        if math.fmod(roll_deg, 360.0) in (180.0, -180.0):
            return cls(offset, -1, cut_angle, roll_deg - 180.0)
        return cls(offset, 1, cut_angle, roll_deg)


@dataclass(frozen=True)
class Guide:
    """A guide or template at a fixed position (mm, slopes 1), through which the needle slides."""

    #: x, y: its place in C, mm: x < 0 before the tissue
    x: float
    y: float = 0.0
    #: slope of its axis in C, which the needle takes on there; None: the needle turns freely in it
    slope: float | None = 0.0
    #: whether it stands in the tissue, x >= 0; it then holds the needle once the tip has passed
    in_tissue: bool = False
    #: what pictures call it; guides that differ in nothing else are the same
    name: str = field(default="", compare=False)
    #: z, slope_z: its place across the plane, mm, and slope of its axis there, if `slope` is not None
    z: float = 0.0
    slope_z: float = 0.0

    def __post_init__(self) -> None:
        if not is_bounded(self.x, self.y, self.slope or 0.0, self.z, self.slope_z):
            raise ModelError(
                f"guide stands at ({self.x}, {self.y}, {self.z}) mm, slopes {self.slope} and {self.slope_z}",
                expected="finite numbers",
            )
        if self.in_tissue != (self.x >= 0):
            raise ModelError(
                f"guide stands at x = {self.x} mm",
                expected="x < 0 before the tissue, x >= 0 with in_tissue",
                fix="move it before the entry, or state in_tissue",
            )


@dataclass(frozen=True)
class TrackedTip:
    """A tip position measured by a tracker, in C: deflection (mm) and, unless None, slope."""

    y: float
    slope: float | None = None
    #: z, slope_z: the same across the plane
    z: float = 0.0
    slope_z: float = 0.0

    def __post_init__(self) -> None:
        if not is_bounded(self.y, self.slope or 0.0, self.z, self.slope_z):
            raise ModelError(
                f"tracked tip is at ({self.y}, {self.z}) mm, slopes {self.slope} and {self.slope_z}",
                expected="finite numbers",
            )


#: fields of a `Controls` for base and stage: first in the plane, then across it
BASE_INPUTS = ("base_y", "base_slope", "stage_slope", "base_z", "base_slope_z", "stage_slope_z")


@dataclass(frozen=True)
class Controls:
    """Boundary conditions on the needle ("V-inputs" of the paper), constant over one step; mm, slopes 1."""

    #: base_y, base_slope: deflection (mm) and slope of the base in C, apart from what the stage axis adds
    base_y: float = 0.0
    base_slope: float = 0.0
    #: slope in C of the axis along which the stage carries the base: at depth D the base stands at y = base_y
    #: + stage_slope D
    stage_slope: float = 0.0
    guides: tuple[Guide, ...] = ()
    tip: TrackedTip | None = None
    #: base_z, base_slope_z, stage_slope_z: the same across the plane
    base_z: float = 0.0
    base_slope_z: float = 0.0
    stage_slope_z: float = 0.0

    def __post_init__(self) -> None:
        if not is_bounded(*self.base):
            raise ModelError(
                f"base and stage have {dict(zip(BASE_INPUTS, self.base, strict=True))}",
                expected="finite numbers",
            )
        require_type("guides", self.guides, Sequence)
        for guide in self.guides:
            require_type("a guide", guide, Guide)
        if self.tip is not None:
            require_type("tip", self.tip, TrackedTip)
        if len(self.guides) > MAX_GUIDES:
            raise ModelError(f"{len(self.guides)} guides", expected=f"at most {MAX_GUIDES}")
        ordered = tuple(sorted(self.guides, key=lambda guide: guide.x))
        for first, other in pairwise(ordered):
            if first.x == other.x:
                raise ModelError(
                    f"two guides stand at the same x = {first.x:g} mm",
                    expected="guides at different x",
                    fix="move one of them, or leave it out",
                )
        # The dataclass is frozen, hence `object.__setattr__`. Sorted, so that the order of guides in a file
        # changes nothing.
        object.__setattr__(self, "guides", ordered)

    @property
    def before(self) -> tuple[Guide, ...]:
        """The guides before the tissue, from the base inwards."""
        return tuple(guide for guide in self.guides if not guide.in_tissue)

    @property
    def within(self) -> tuple[Guide, ...]:
        """The guides in the tissue, from the entry inwards."""
        return tuple(guide for guide in self.guides if guide.in_tissue)

    @property
    def base(self) -> tuple[float, ...]:
        """The state of base and stage: the values of `BASE_INPUTS`."""
        return (
            self.base_y, self.base_slope, self.stage_slope, self.base_z, self.base_slope_z, self.stage_slope_z
        )  # fmt: skip

    @property
    def act_along_z(self) -> bool:
        """Whether one of them moves or turns the needle along z."""
        held: tuple[Guide | TrackedTip, ...] = (*self.guides, self.tip) if self.tip else self.guides
        moved = self.base_z or self.base_slope_z or self.stage_slope_z
        return bool(moved) or any(hold.z or (hold.slope is not None and hold.slope_z) for hold in held)


@dataclass(frozen=True)
class Step:
    """One step of an insertion: the tip moves to `depth` (mm) under constant inputs.

    A depth below the one before is a retraction, the same depth a mere change of the inputs.
    """

    depth: float
    bevel: Bevel
    controls: Controls = Controls()

    def __post_init__(self) -> None:
        if not (is_bounded(self.depth) and self.depth >= 0):
            raise ModelError(f"depth is {self.depth} mm", expected="a finite number, not negative")
        require_type("bevel", self.bevel, Bevel)
        require_type("controls", self.controls, Controls)
        if self.depth > MAX_NEEDLE_LENGTH_MM:
            raise ModelError(f"depth is {self.depth:g} mm", expected=f"at most {MAX_NEEDLE_LENGTH_MM:g} mm")

    @property
    def acts_along_z(self) -> bool:
        """Whether bevel or boundary conditions lead a needle out of the plane z = 0."""
        return (self.bevel.roll_deg != 0 and self.bevel.toward[1] != 0) or self.controls.act_along_z


#: largest tolerance of Newton's method (mm): with a larger one it ends before the first correction
COARSEST_TOLERANCE_MM = 1e-3


@dataclass(frozen=True)
class ModelOptions:
    """Options of the model and the solver: discretisation, tolerances, variants of the rule of advance.

    `spacing`, `element`, `tolerance` and `first_cell` are in mm.
    """

    #: constraint spacing C_int, mm: part of the model, fits with different values are never compared
    spacing: float = 1.0
    element: float = 1.0  #: mesh size h, mm, a divisor of `spacing`: purely numerical
    tolerance: float = 1e-7  #: Newton stops when no node moves by more than this, mm
    max_iterations: int = 40  #: a step that takes more has not converged
    #: where between two constraint points, in parts of the way from the one behind to the one ahead, the
    #: tissue changes from the one to the other. 0.5: each point of the needle belongs to the nearest; 0 and
    #: 1: every cell to the one ahead, or behind.
    switch: float = 0.5
    #: part of its slope that the tip takes on when it advances: 1 along its tangent, 0 a mere shift in x
    tangent: float = 1.0
    #: depth of the first constraint point, mm; None: the last cell is whole. A `Session` has its own.
    first_cell: float | None = None
    #: "tangent", the paper's rule: along the tip's tangent, turned by `Bevel.offset` per constraint spacing.
    #: "path_angle": at `Bevel.cut_angle` to the needle's tangent; `switch` and `tangent` are then not used.
    advance: Advance = "tangent"

    def __post_init__(self) -> None:
        if self.advance not in get_args(Advance):
            raise ModelError(
                f"advance is {self.advance!r:.60}", expected=f"one of {', '.join(get_args(Advance))}"
            )
        if not (is_bounded(self.tolerance) and 0 < self.tolerance <= COARSEST_TOLERANCE_MM):
            raise ModelError(
                f"tolerance is {self.tolerance} mm", expected=f"above 0, at most {COARSEST_TOLERANCE_MM:g} mm"
            )
        if self.advance == "path_angle" and (self.switch, self.tangent) != (0.5, 1.0):
            raise ModelError(
                f"switch is {self.switch}, tangent is {self.tangent}",
                expected='0.5 and 1: these are variants of advance = "tangent"',
            )
        parts = (self.switch, self.tangent)
        if not (is_bounded(*parts) and min(parts) >= 0 and max(parts) <= 1):
            raise ModelError(
                f"switch is {self.switch}, tangent is {self.tangent}", expected="both from 0 to 1"
            )
        if not (isinstance(self.max_iterations, int) and 1 <= self.max_iterations <= MAX_ITERATIONS):
            raise ModelError(
                f"max_iterations is {self.max_iterations}", expected=f"from 1 to {MAX_ITERATIONS}"
            )
        if not is_bounded(self.spacing, self.element, self.first_cell or 0.0):
            raise ModelError(
                f"constraint spacing is {self.spacing} mm, element size {self.element} mm, first cell "
                f"{self.first_cell} mm",
                expected="finite numbers",
            )
        if 0 < min(self.element, self.spacing) < MIN_ELEMENT_MM:
            raise ModelError(
                f"elements of {min(self.element, self.spacing):g} mm",
                expected=f"{MIN_ELEMENT_MM:g} mm or more",
                fix="1 mm is enough",
            )
        if self.spacing > MAX_CONSTRAINT_SPACING_MM:
            raise ModelError(
                f"constraint spacing is {self.spacing:g} mm",
                expected=f"at most {MAX_CONSTRAINT_SPACING_MM:g} mm",
                fix="1 mm is the model's; a larger one needs its own fit",
            )
        ratio = self.spacing / self.element if self.element > 0 else 0.0
        if not (self.spacing > 0 and round(ratio) >= 1 and math.isclose(ratio, round(ratio), rel_tol=1e-3)):
            raise ModelError(
                f"element size {self.element} mm does not divide the constraint spacing {self.spacing} mm",
                expected="element_mm = constraint_spacing_mm / 1, 2, 3, ... (to three digits)",
                fix="leave element_mm out",
            )
        object.__setattr__(self, "element", self.spacing / round(ratio))  # 0.333 means a third

    @property
    def path_angle(self) -> bool:
        """Whether the needle advances by the path angle."""
        return self.advance == "path_angle"

    @property
    def cut_switch(self) -> float:
        """Return `switch` as the kernel reads it: LINEAR_CUT where the cut is linear between its points."""
        return LINEAR_CUT if self.path_angle else self.switch

    def bevel_strength(self, bevel: Bevel) -> tuple[float, float]:
        """Return how strongly a bevel turns the cut: b (mm) over C_int (mm), or theta (rad) over 1.

        Raises ModelError if the bevel's strength is that of the other rule.
        """
        if (bevel.offset if self.path_angle else bevel.cut_angle) != 0:
            raise ModelError(
                f"bevel has offset {bevel.offset} mm, angle {bevel.cut_angle} rad",
                expected=f"{'cut_angle' if self.path_angle else 'offset'} alone: advance is {self.advance}",
            )
        return (bevel.cut_angle, 1.0) if self.path_angle else (bevel.offset, self.spacing)

    @classmethod
    def from_record(cls, record: RulesRecord) -> Self:
        """Return the options that a validated record describes."""
        return cls(
            record.constraint_spacing_mm,
            record.element,
            switch=record.constraint_switch,
            tangent=record.tangent_part,
            first_cell=record.first_cell_mm,
            advance=record.advance,
            tolerance=record.tolerance_mm or cls.tolerance,
        )
