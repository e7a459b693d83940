"""The lateral loads on the needle: the tissue's load along the shaft, and the reactions of the supports."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import native
from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import pack_equilibrium
from needlefit.mechanics.tissue import Tissue

_DEFAULT_OPTIONS = ModelOptions()


@dataclass(frozen=True)
class SupportReaction:
    """Force and moment of one support (base, guide or tracked tip) on the needle."""

    x: float  #: beam coordinate, mm
    force: float = 0.0  #: N, toward +y
    moment: float = 0.0  #: N mm, turning x toward y; 0 where the needle turns freely


@dataclass(frozen=True)
class Loads:
    """All loads across the needle's axis, in the constraint frame C; positive toward +y."""

    s: Floats  #: (K,) beam coordinates in the tissue at which the model integrates the load, increasing, mm
    #: (K,) lateral load of the tissue there, N/mm; it jumps where constraint point or layer change
    load: Floats
    #: (K,) length of shaft that each of them stands for, mm: the tissue's force is `weight @ load`
    weight: Floats
    #: force of the tissue on the stretch that belongs to the last constraint point, N
    tip_region_force: float
    base: SupportReaction
    #: one for each of the controls' guides, in their order; all 0 for one that does not hold yet
    guides: tuple[SupportReaction, ...]
    tip: SupportReaction  #: what holds a tracked tip where it is; all 0 where the tip is free

    @property
    def tip_force(self) -> float:
        """Lateral force on the tip, N: the tissue's around the tip, plus that of a tracker that holds it."""
        return self.tip_region_force + self.tip.force

    @property
    def tissue(self) -> SupportReaction:
        """The tissue's force on the whole shaft, N, and its moment about the entry, N mm."""
        forces = self.weight * self.load
        return SupportReaction(0.0, float(forces.sum()), float(forces @ self.s))

    @property
    def all_loads(self) -> tuple[SupportReaction, ...]:
        """The tissue's load and all supports: together they are in balance."""
        return self.tissue, self.base, *self.guides, self.tip


def compute_loads(
    shape: NeedleShape,
    tissue: Tissue,
    needle: Needle,
    controls: Controls,
    rules: ModelOptions = _DEFAULT_OPTIONS,
) -> Loads:
    """Return all loads on a needle in equilibrium: docs/model.md, section 3.

    `tissue`, `needle` and `rules` are those under which it was found, `controls` those of its last step. NaN
    where the shape is, if it did not converge.
    """
    depths = np.ascontiguousarray(shape.constraints[:, 0])
    problem = pack_equilibrium(needle, tissue, depths, controls, rules)
    front = int(np.searchsorted(shape.x, 0.0))  # base and guides before the tissue
    s, weight, _, near = native.list_quadrature(problem, shape.x[front:].copy(), depths)
    bent = shape.x, shape.u, shape.slope, shape.constraints
    load = native.compute_load(problem, bent, s)
    last = int(np.searchsorted(near, len(depths) - 1))  # the first that belongs to the last constraint point
    nodal_forces = native.balance_nodes(problem, bent, front, load)
    # Supports have nodes at exactly their x, so a node is found by its coordinate.
    reactions = dict(zip(shape.x.tolist(), nodal_forces.tolist(), strict=True))

    def read(x: float, clamped: bool) -> SupportReaction:
        force, moment = reactions.get(x, (0.0, 0.0))  # a guide without a node holds nothing
        return SupportReaction(x, force, moment if clamped else 0.0)

    return Loads(
        s,
        load,
        weight,
        tip_region_force=float(weight[last:] @ load[last:]),
        base=read(float(shape.x[0]), clamped=True),
        guides=tuple(read(guide.x, guide.slope is not None) for guide in controls.guides),
        tip=SupportReaction(shape.depth)
        if controls.tip is None
        else read(shape.depth, controls.tip.slope is not None),
    )


def compute_lateral_load(
    shape: NeedleShape, tissue: Tissue, s: Floats, rules: ModelOptions = _DEFAULT_OPTIONS
) -> Floats:
    """Return the lateral load (K,) of the tissue, N/mm, at beam coordinates `s` (K,), mm.

    Where the load jumps, that of the side nearer to the base.
    """
    needle = Needle(shape.x[-1] - shape.x[0], 1.0)
    depths = np.ascontiguousarray(shape.constraints[:, 0])
    problem = pack_equilibrium(needle, tissue, depths, Controls(), rules)
    bent = shape.x, shape.u, shape.slope, shape.constraints
    return native.compute_load(problem, bent, np.ascontiguousarray(s, dtype=np.float64))
