"""The result of a simulation, the needle's shape in the constraint frame C, and whether to trust it.

A solution may converge and still break the model's assumptions. Each quantity of `Validity` is the worst of
the whole needle, and each has a limit; docs/developers/solver.md, "Validity of a solution", states why.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any, Literal

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.tissue import Tissue

#: largest slope |u'| for the assumption of small slopes: u' and its sine then differ by 1.5 %
MAX_SLOPE = 0.3
#: largest deflection over length: a cantilever under an end force then has a slope of 0.3, and linear theory
#: is 4 % off
MAX_DEFLECTION_PER_LENGTH = 0.2
#: largest shortening over the thickness of the thinnest layer: the needle's points lie nearer to the entry
#: than the model assumes. Beyond half of that layer, most of its load is assigned to another layer.
MAX_SHORTENING_PER_LAYER = 0.5
#: largest distance (mm) by which a needle's points may miss guides and entry. Guides hold deflections,
#: integrals of u'; the points are integrals of sin u'. Guides are hardly measured better.
MAX_MISS_MM = 0.1
#: largest |e| / t: compression tests of soft tissue, the basis of the laws, end at about half the thickness
MAX_COMPRESSION = 0.5


@dataclass(frozen=True)
class Validity:
    """How near a solution comes to the limits of the model's assumptions; of a batch with leading axes (...).

    All are NaN where there is no solution, and such a one is not `ok`.
    """

    max_slope: Floats  #: (...) greatest |u'| of the needle, between its nodes too, and of its tip on the way
    deflection_per_length: Floats  #: (...) range of the needle's deflections over its length
    #: (...) how much nearer to the base the tip lies than the needle's length, over the thinnest layer that
    #: it has entered (at least one constraint spacing); 0 where the tissue is one layer
    shortening_per_layer: Floats
    #: (...) greatest |integral of u' - sin u'| from the base to the entry: how far the needle's points miss
    #: the places of the guides before the tissue and of the first contact, mm
    miss_mm: Floats
    compression: Floats  #: (...) greatest |e| / t at a constraint point

    @property
    def ok(self) -> Bools:
        """Whether every quantity is within its limit, (...)."""
        return np.logical_and.reduce([getattr(self, name) <= limit for name, limit, _ in LIMITS])

    @property
    def faults(self) -> tuple[str, ...]:
        """Descriptions of the quantities of a single solution that exceed their limits."""
        return tuple(
            f"{words} {float(value):.3g}{_unit(name)} (limit {limit:g}{_unit(name)})"
            for name, limit, words in LIMITS
            if (value := getattr(self, name)) > limit
        )

    def table(self) -> dict[str, Any]:
        """Return a single solution's quantities as JSON values, with `ok` and `faults`."""
        values = {name: float(getattr(self, name)) for name, _, _ in LIMITS}
        return {"ok": bool(self.ok), **values, "faults": list(self.faults)}


def _unit(name: str) -> str:
    return " mm" if name.endswith("_mm") else ""


LIMITS: tuple[tuple[str, float, str], ...] = (
    ("max_slope", MAX_SLOPE, "slope"),
    ("deflection_per_length", MAX_DEFLECTION_PER_LENGTH, "deflection over length"),
    ("shortening_per_layer", MAX_SHORTENING_PER_LAYER, "shortening over the thinnest layer"),
    ("miss_mm", MAX_MISS_MM, "miss of guides or entry"),
    ("compression", MAX_COMPRESSION, "compression of the tissue"),
)  #: attribute of `Validity`, its limit, and its printed name


def find_worst(solutions: Sequence[Validity]) -> Validity:
    """Return the worst value of each quantity over several single solutions; failed ones are left out."""
    worst = {name: np.array([getattr(solution, name) for solution in solutions]) for name, _, _ in LIMITS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all failed: NaN
        return Validity(**{name: np.nanmax(values) for name, values in worst.items()})


@dataclass(frozen=True)
class Solution:
    """The nodes of one bent needle in C, base first, tip last; of B needles with a leading axis of B.

    `x` is the beam coordinate (arc length, 0 at the entry) and u the deflection that the equations know, not
    the place in space: see `compute_positions`.
    """

    #: x, u, slope: (N,) node, deflection (mm) along y and slope u'
    x: Floats
    u: Floats
    slope: Floats
    #: w, slope_z: (N,) deflection along z (mm) and its slope
    w: Floats
    slope_z: Floats
    constraints: Floats  #: (M + 1, 3) depth, y and z of the constraint points, mm; point 0 is first contact
    #: (M + 1, 4) of the tip as it stood at each constraint point: deflection (mm) and slope along y, along z
    tip_track: Floats


def compute_validity(solved: Solution, scales: Floats) -> Validity:
    """Return the validity of a solution, or of each solution of a batch, by `scales` (..., 2)."""
    x, planes = solved.x, _pair_planes(solved)
    length, step = x[..., -1] - x[..., 0], np.diff(x, axis=-1)
    before_entry = x[..., :-1] < ENTRY_TOLERANCE_MM
    track = solved.tip_track
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        steepest, shortening, misses = _find_slopes(planes, step)
        missed = [np.where(before_entry, miss.cumsum(axis=-1), 0.0) for miss in misses]
        return Validity(
            np.maximum(
                steepest, _find_size([track[..., 2 * i + 1] for i in range(len(planes))]).max(axis=-1)
            ),
            _find_size([u.max(axis=-1) - u.min(axis=-1) for u, _ in planes]) / length,
            shortening / scales[..., 0],
            _find_size(missed).max(axis=-1),
            _find_compression(solved) / scales[..., 1],
        )


def list_planes(solved: Solution) -> tuple[Floats, Floats]:
    """Return deflections and slopes (P, ..., N), in the planes for which the kernel solved."""
    u, slope = (native.stack_planes(*pair) for pair in ((solved.u, solved.w), (solved.slope, solved.slope_z)))
    return u, slope


def _pair_planes(solved: Solution) -> list[tuple[Floats, Floats]]:
    """Return deflection and slope along y and, of a needle that leaves the plane z = 0, along z."""
    return list(zip(*list_planes(solved), strict=True))


def _find_size(parts: Sequence[Floats]) -> Floats:
    """Return the length of a vector whose parts along y, and z, are given."""
    return np.abs(reduce(np.hypot, parts))


ENTRY_TOLERANCE_MM = -1e-9  #: smallest depth (mm) at which an element in the tissue begins: 0 within rounding


def _find_slopes(
    planes: Sequence[tuple[Floats, Floats]], step: Floats
) -> tuple[Floats, Floats, list[Floats]]:
    """Return the greatest |u'| of the cubics between nodes, by how much the needle shortens, mm, and the
    integrals of u' less the direction's part along y, and z, over each element, (..., N - 1), mm.
    """
    cubics = []
    for u, slope in planes:
        begin, end, mean = slope[..., :-1], slope[..., 1:], np.diff(u, axis=-1) / step
        # u' = begin + t bend + t^2 curl
        cubics.append((begin, 6 * mean - 4 * begin - 2 * end, 3 * (begin + end) - 6 * mean))

    def evaluate(t: float | Floats) -> list[Floats]:
        return [begin + t * (bend + t * curl) for begin, bend, curl in cubics]

    if len(planes) == 1:
        # Extremes of the slope inside an element lie where u'' = 0. A cubic without curl has none.
        ((_, bend, curl),) = cubics
        vertex = np.divide(-0.5 * bend, curl, out=np.zeros_like(curl), where=np.abs(curl) > 1e-12)
        inside = [evaluate(np.where((vertex > 0) & (vertex < 1), vertex, 0.0))]
    else:
        inside = [evaluate(t) for t in (0.25, 0.5, 0.75)]
    places = [*inside, [slope for _, slope in planes]]
    steepest = np.max([_find_size(slopes).max(axis=-1) for slopes in places], axis=0)
    shortening, misses = np.zeros(()), [np.zeros(())] * len(planes)
    for t, weight in _GAUSS:
        rotations = evaluate(t)
        angle = _find_size(rotations)
        shortening = shortening + weight * 2 * np.sin(angle / 2) ** 2
        across = [
            np.sin(rotation) if len(planes) == 1 else rotation * np.sinc(angle / np.pi)
            for rotation in rotations
        ]
        misses = [
            sum_ + weight * (rotation - part)
            for sum_, rotation, part in zip(misses, rotations, across, strict=True)
        ]
    return steepest, (shortening * step).sum(axis=-1), [miss * step for miss in misses]


#: places and weights of Gauss-Legendre quadrature with three points on [0, 1]
_GAUSS = ((0.5 - math.sqrt(0.15), 5 / 18), (0.5, 4 / 9), (0.5 + math.sqrt(0.15), 5 / 18))


def _find_compression(solved: Solution) -> Floats:
    """Return the greatest distance of the needle from a constraint point, mm."""
    depths = solved.constraints[..., 0]
    nodes = solved.x.reshape(-1, solved.x.shape[-1])[0]  # all have theirs in the same order
    depth = depths.reshape(-1, depths.shape[-1])[0]
    before = np.clip(np.searchsorted(nodes, depth - 1e-9), 1, len(nodes) - 1) - 1
    start, span = solved.x[..., before], solved.x[..., before + 1] - solved.x[..., before]
    t = np.clip((depth - start) / span, 0.0, 1.0)
    away = []
    for plane, (u, slope) in enumerate(_pair_planes(solved)):
        u0, u1, s0, s1 = u[..., before], u[..., before + 1], slope[..., before], slope[..., before + 1]
        bend = 3 * (u1 - u0) - span * (2 * s0 + s1)
        curl = 2 * (u0 - u1) + span * (s0 + s1)
        away.append(u0 + t * (span * s0 + t * (bend + t * curl)) - solved.constraints[..., 1 + plane])
    return _find_size(away).max(axis=-1)


def compute_scales(tissue: Tissue, depth: float, spacing: float, boundaries: Floats | None = None) -> Floats:
    """Return the reference lengths (..., 2) of validity for a needle at `depth`, mm.

    The thinnest of the layers that it has entered, at least one constraint spacing (infinite for the only
    layer), and their least thickness t. `boundaries` (..., n - 1), mm, replace those of the tissue.
    """
    ends = tissue.boundaries if boundaries is None else boundaries
    entered = np.insert(ends < depth, 0, True, axis=-1)
    widths = np.diff(ends, axis=-1, prepend=0.0)
    widths[(widths <= 0) | ~entered[..., :-1]] = np.inf
    thickness = np.where(entered, tissue.thickness, np.inf).min(axis=-1)
    return np.stack([np.maximum(widths.min(axis=-1, initial=np.inf), spacing), thickness], axis=-1)


Status = Literal["converged", "over-compressed", "not converged", "non-finite"]


@dataclass(frozen=True)
class NeedleShape(Solution):
    """The shape of a needle."""

    #: "converged", or why it is not; then what was not reached is NaN, the whole shape with it
    status: Status
    iterations: int  #: Newton iterations over all steps
    #: (2,) what validity is measured by: see `compute_scales`; infinite where there is no tissue
    scales: Floats = field(default_factory=lambda: np.full(2, np.inf))

    @cached_property
    def validity(self) -> Validity:
        """How far the solution keeps within the model's assumptions; NaN where there is no solution."""
        return compute_validity(self, self.scales)

    @property
    def valid(self) -> bool:
        """Whether the solution converged and keeps within the model's assumptions."""
        return self.converged and bool(self.validity.ok)

    @property
    def converged(self) -> bool:
        """Whether every step reached the tolerance."""
        return self.status == "converged"

    @property
    def depth(self) -> float:
        """Inserted arc length, mm."""
        return float(self.x[-1])

    @property
    def tip_path(self) -> Floats:
        """Depth and deflections of the tip as it stood at each constraint point, as `constraints`, mm."""
        return np.column_stack((self.constraints[:, 0], self.tip_track[:, ::2]))

    @property
    def tip_lateral(self) -> float:
        """The y of the tip in C, mm, where `compute_positions` has it."""
        return float(compute_positions(self, self.x[-1:])[0, 1])

    @property
    def tip_z(self) -> float:
        """The z of the tip in C, mm."""
        return float(compute_positions(self, self.x[-1:])[0, 2])

    @property
    def tip_direction(self) -> tuple[float, float]:
        """The direction of the tip in C, rad: its angle from x toward y, and its elevation toward z."""
        along_y, along_z = float(self.slope[-1]), float(self.slope_z[-1])
        size = math.hypot(along_y, along_z)  # of the rotation
        y, z = (component * math.sin(size) / (size or 1.0) for component in (along_y, along_z))
        elevation = math.asin(z) if math.isfinite(z) else math.nan
        return (math.atan2(y, math.cos(size)) if along_z else along_y), elevation

    @property
    def leaves_plane(self) -> bool:
        """Whether a point of the needle lies outside of the plane z = 0."""
        return bool(self.w.any())


def compute_positions(shape: NeedleShape, s: Floats) -> Floats:
    """Return the points (K, 3) of the needle in C, mm, at given beam coordinates.

    The slopes u' and w' along y and z are a rotation of the needle's section by th, th^2 = u'^2 + w'^2: the
    needle goes along (cos th, u' sin th / th, w' sin th / th), from the base, which stands at its own beam
    coordinate and deflections. It keeps its length, and the tip lags a little behind its depth. In the plane
    z = 0 that is x(s) = integral of cos u', y(s) = integral of sin u'.

    The coordinates `s` (K,), mm, are 0 at the entry, `shape.depth` at the tip, negative before the tissue.

    Raises ModelError if a coordinate lies outside the needle.
    """
    wanted = np.ascontiguousarray(s, dtype=np.float64)
    # The last of a row of equidistant coordinates may lie beyond the tip by rounding.
    slack = 1e-9 * max(1.0, shape.depth)
    if wanted.min() < shape.x[0] - slack or wanted.max() > shape.x[-1] + slack:
        raise ModelError(
            f"beam coordinates {wanted.min():g} ... {wanted.max():g} mm leave the needle",
            expected=f"{shape.x[0]:g} ... {shape.x[-1]:g} mm",
        )
    u, slope = (part[:, None] for part in list_planes(shape))
    return native.compute_positions(shape.x[None], u, slope, wanted)[0]


def sample_inserted_points(shape: NeedleShape, stations: int = 101) -> Floats:
    """Return points (stations, 3) in C at equal fractions of the inserted length, from entry to tip."""
    return compute_positions(shape, np.linspace(0.0, shape.depth, stations))
