"""All loads on a needle in equilibrium, and where they act: for tests, the verification and figures."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import native
from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape, compute_positions, list_planes
from needlefit.mechanics.simulate import pack_equilibrium
from needlefit.mechanics.tissue import Tissue

_DEFAULT_OPTIONS = ModelOptions()


@dataclass(frozen=True)
class SupportReaction:
    """Force and moment of one support (base, guide or tracked tip) on the needle."""

    x: float  #: beam coordinate, mm
    force: float = 0.0  #: N, toward +y
    moment: float = 0.0  #: N mm, turning x toward y; 0 where the needle turns freely
    #: force_z, moment_z: toward +z, and turning x toward z
    force_z: float = 0.0
    moment_z: float = 0.0


@dataclass(frozen=True)
class Loads:
    """All loads across the needle's axis, in the constraint frame C; positive toward +y and +z."""

    s: Floats  #: (K,) beam coordinates in the tissue at which the model integrates the load, increasing, mm
    #: (K,) lateral load of the tissue there, N/mm; it jumps where constraint point or layer change
    load: Floats
    load_z: Floats  #: (K,) the same along z
    #: (K,) length of shaft that each of them stands for, mm: the tissue's force is `weight @ load`
    weight: Floats
    #: tip_region_force, tip_region_force_z: of the tissue on the stretch of the last constraint point, N
    tip_region_force: float
    tip_region_force_z: float
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
        forces = [self.weight * load for load in (self.load, self.load_z)]
        numbers = [number for force in forces for number in (float(force.sum()), float(force @ self.s))]
        return SupportReaction(0.0, *numbers)


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
    depths, (u, slope) = np.ascontiguousarray(shape.constraints[:, 0]), list_planes(shape)
    problem = pack_equilibrium(needle, tissue, depths, controls, rules, len(u))
    front = int(np.searchsorted(shape.x, 0.0))  # base and guides before the tissue
    s, weight, _, near = native.list_quadrature(problem, shape.x[front:].copy(), depths)
    bent = shape.x, u, slope, shape.constraints
    load = native.compute_load(problem, bent, s)  # (2, K)
    last = int(np.searchsorted(near, len(depths) - 1))  # the first that belongs to the last constraint point
    nodal_forces = native.balance_nodes(problem, bent, front, load).swapaxes(0, 1)  # (N, 2, 2)
    # Supports have nodes at exactly their x, so a node is found by its coordinate.
    reactions = dict(zip(shape.x.tolist(), nodal_forces.tolist(), strict=True))

    def read(x: float, clamped: bool) -> SupportReaction:
        held = reactions.get(x, [])  # a guide without a node holds nothing
        return SupportReaction(x, *(n for force, moment in held for n in (force, moment if clamped else 0.0)))

    load_y, load_z = load
    return Loads(
        s,
        load_y,
        load_z,
        weight,
        tip_region_force=float(weight[last:] @ load_y[last:]),
        tip_region_force_z=float(weight[last:] @ load_z[last:]),
        base=read(float(shape.x[0]), clamped=True),
        guides=tuple(read(guide.x, guide.slope is not None) for guide in controls.guides),
        tip=SupportReaction(shape.depth)
        if controls.tip is None
        else read(shape.depth, controls.tip.slope is not None),
    )


def map_beam_points(shape: NeedleShape, points: Floats) -> Floats:
    """Return points (K, 3), given by beam coordinate and deflections, in those of `compute_positions`.

    Each point moves with the point of the needle at its beam coordinate: its distance from the needle, across
    x, is then the e of the model.
    """
    s = np.ascontiguousarray(points[:, 0])
    along = ((points[:, 1], shape.u, shape.slope), (points[:, 2], shape.w, shape.slope_z))
    beside = [place - native.compute_deflections(shape.x, u, slope, s) for place, u, slope in along]
    return compute_positions(shape, s) + np.column_stack((np.zeros(len(s)), *beside))
