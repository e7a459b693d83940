"""Batches: one insertion with many parameter sets, and the needle shapes that result."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats, Ints
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.insertion_limits import count_element_solves
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.prepared import PreparedInsertion
from needlefit.mechanics.shape import NeedleShape, Status
from needlefit.mechanics.simulate import STATUS_NAMES
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import Validity, compute_validity
from needlefit.schemas.limits import MAX_BATCH_ELEMENT_SOLVES, MAX_BATCH_NODES


@dataclass(frozen=True)
class Batch:
    """One insertion with B parameter sets; what is None has the value of `needle`, `tissue` and `steps` in
    all sets.

    Attributes
    ----------
    needle, tissue, steps, rules
        The insertion, as `simulate.simulate_steps` takes it.
    mu : (B, n) array
        Of the n layers of `tissue`, MPa.
    shape : (B, p, n) array
        Shape parameters of the law of `tissue`, in its order.
    offset, cut_angle : (B,) arrays
        Of every bevel, mm and rad; sides stay.
    rigidity : (B,) array
        EI, N mm^2.
    base_y, base_slope : (B,) arrays
        Of the base in every step, mm and 1.
    guide_x : (B,) array
        Where the one guide before the tissue stands, mm; there must be one.
    alpha : (B, n) array
        In place of `shape`, of a law whose one parameter is alpha.
    prepared : mapping
        The insertion as the kernel reads it, by kinds of derivatives; filled when it is first used.
    """

    needle: Needle
    tissue: Tissue
    steps: tuple[Step, ...]
    rules: ModelOptions = ModelOptions()
    mu: Floats | None = None
    shape: Floats | None = None
    offset: Floats | None = None
    cut_angle: Floats | None = None
    rigidity: Floats | None = None
    base_y: Floats | None = None
    base_slope: Floats | None = None
    guide_x: Floats | None = None
    alpha: InitVar[Floats | None] = None
    prepared: dict[tuple[str, ...] | None, PreparedInsertion] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self, alpha: Floats | None) -> None:
        if alpha is not None:
            if LAWS[self.tissue.law].shape_names != ("alpha",) or self.shape is not None:
                raise ModelError(
                    "a batch is given alpha",
                    expected="shape, or alpha alone, of a law with no other parameter",
                )
            object.__setattr__(self, "shape", np.asarray(alpha)[:, None])
        sizes = {}
        for name in VARYING_FIELDS:
            value = getattr(self, name)
            if value is None:
                continue
            one = getattr(self.tissue, name).shape if name in ("mu", "shape") else ()
            array = np.ascontiguousarray(value, dtype=np.float64)
            if array.ndim != 1 + len(one) or array.shape[1:] != one:
                expected = ", ".join(map(str, ("B", *one)))
                raise ModelError(f"batch {name} has shape {array.shape}", expected=f"({expected})")
            sizes[name] = len(array)
            object.__setattr__(self, name, array)
        if len(set(sizes.values())) != 1 or 0 in sizes.values():
            raise ModelError(
                f"a batch whose sets are {sizes or 'not given'}", expected="one size B for all, at least 1"
            )
        if self.guide_x is not None and any(len(step.controls.before) != 1 for step in self.steps):
            raise ModelError("guide_x is given", expected="exactly one guide before the tissue in every step")
        object.__setattr__(self, "steps", tuple(self.steps))
        self._check_size()

    def __len__(self) -> int:
        return self._count

    @cached_property
    def _count(self) -> int:
        return len(next(v for v in (getattr(self, name) for name in VARYING_FIELDS) if v is not None))

    def _check_size(self) -> None:
        """Raise ModelError where all sets together would take minutes or gigabytes."""
        depths, element = tuple(step.depth for step in self.steps), self.rules.element
        solves = len(self) * count_element_solves(depths, self.rules.spacing, element)
        nodes = len(self) * max(depths, default=0.0) / element
        if solves > MAX_BATCH_ELEMENT_SOLVES or nodes > MAX_BATCH_NODES:
            raise ModelError(
                f"a batch of {len(self)} sets is {solves:.3g} elements to be solved for, {nodes:.3g} nodes",
                expected=f"at most {MAX_BATCH_ELEMENT_SOLVES:.3g}, and {MAX_BATCH_NODES:.3g} nodes",
                fix="divide the sets among several batches, one call after the other",
            )

    def with_sets(self, **values: Floats) -> Self:
        """Return the same insertion with other sets of the same parameters; both share what is prepared.

        Raises
        ------
        ModelError
            If these are not the parameters that this batch varies.
        """
        given = {name for name in VARYING_FIELDS if getattr(self, name) is not None}
        if values.keys() != given:
            raise ModelError(f"sets of {', '.join(values)}", expected=f"of {', '.join(sorted(given))}")
        changed: dict[str, Any] = dict(values)
        other = replace(self, **changed)
        object.__setattr__(other, "prepared", self.prepared)
        return other

    def pick(self, i: int) -> tuple[Needle, Tissue, tuple[Step, ...], ModelOptions]:
        """Return set i as the arguments of `simulate.simulate_steps`."""
        needle, steps = self.vary_inputs(i)
        tissue = replace(
            self.tissue,
            mu=self.tissue.mu if self.mu is None else self.mu[i],
            shape=self.tissue.shape if self.shape is None else self.shape[i],
        )
        return needle, tissue, steps, self.rules

    def vary_inputs(self, i: int) -> tuple[Needle, tuple[Step, ...]]:
        """Return needle and steps with the parameters of set i."""

        def choose(name: str, default: float) -> float:
            values = getattr(self, name)
            return default if values is None else float(values[i])

        def change_step(step: Step) -> Step:
            controls = replace(
                step.controls,
                base_y=choose("base_y", step.controls.base_y),
                base_slope=choose("base_slope", step.controls.base_slope),
            )
            if self.guide_x is not None:
                (guide,) = step.controls.before
                shifted_guide = replace(guide, x=float(self.guide_x[i]))
                controls = replace(controls, guides=(shifted_guide, *step.controls.within))
            angle = choose("cut_angle", step.bevel.cut_angle)
            bevel = Bevel(choose("offset", step.bevel.offset), step.bevel.side, angle)
            return Step(step.depth, bevel, controls)

        needle = replace(self.needle, flexural_rigidity=choose("rigidity", self.needle.flexural_rigidity))
        return needle, tuple(change_step(step) for step in self.steps)


VARYING_FIELDS = tuple(one.name for one in fields(Batch) if one.init)[4:]
"""What a set may give."""


@dataclass(frozen=True)
class NeedleShapes:
    """The shapes of a batch: the fields of `NeedleShape` with a leading axis of B sets.

    Attributes
    ----------
    x, u, slope : (B, N) arrays
    constraints : (B, M + 1, 2) array
    tip_track : (B, M + 1, 2) array
    status : (B,) array of int
        Into `simulate.STATUS_NAMES`; 0: converged.
    iterations : (B,) array of int
    scales : (B, 3) array
    """

    x: Floats
    u: Floats
    slope: Floats
    constraints: Floats
    tip_track: Floats
    status: Ints
    iterations: Ints
    scales: Floats

    def __len__(self) -> int:
        return len(self.u)

    def __getitem__(self, i: int) -> NeedleShape:
        return NeedleShape(
            self.x[i], self.u[i], self.slope[i], self.constraints[i], self.tip_track[i],
            STATUS_NAMES[self.status[i]], int(self.iterations[i]), self.scales[i],
        )  # fmt: skip

    def take(self, sets: slice) -> "NeedleShapes":
        """Return some of the sets; their arrays are views."""
        return NeedleShapes(*(getattr(self, one.name)[sets] for one in fields(self)))

    @classmethod
    def from_shapes(cls, shapes: Sequence[NeedleShape]) -> Self:
        """Return several shapes of the same insertion as one batch."""
        return cls(
            np.array([shape.x for shape in shapes]),
            np.array([shape.u for shape in shapes]),
            np.array([shape.slope for shape in shapes]),
            np.array([shape.constraints for shape in shapes]),
            np.array([shape.tip_track for shape in shapes]),
            np.array([STATUS_NAMES.index(shape.status) for shape in shapes]),
            np.array([shape.iterations for shape in shapes]),
            np.array([shape.scales for shape in shapes]),
        )

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether each set reached the tolerance, (B,)."""
        return np.equal(self.status, 0)

    @cached_property
    def validity(self) -> Validity:
        """Validity of each set's solution, arrays (B,); NaN where the solution failed."""
        return compute_validity(self)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Whether each set converged and keeps within the model's assumptions, (B,)."""
        return self.converged & self.validity.ok

    @property
    def failures(self) -> Counter[Status]:
        """How many sets failed, by reason."""
        return Counter(STATUS_NAMES[status] for status in self.status if status != 0)


def compute_batch_positions(shapes: NeedleShapes, s: Floats) -> Floats:
    """Return the points (B, K, 2) in C of every needle at `s` (K,), mm; see `compute_positions`."""
    parts = (np.ascontiguousarray(part, dtype=np.float64) for part in (shapes.x, shapes.u, shapes.slope, s))
    return native.compute_positions(*parts)
