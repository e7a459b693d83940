"""The result of a simulation: the needle's shape in the constraint frame C."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.validity import Validity, compute_validity, make_unknown_scales

Status = Literal["converged", "over-compressed", "not converged", "non-finite"]


@dataclass(frozen=True)
class NeedleShape:
    """The shape of a needle: the nodes of the bent beam in C, base first, tip last.

    `x` is the beam coordinate (arc length, 0 at the entry) and u the deflection that the equations know, not
    the place in space: see `compute_positions`.

    Attributes
    ----------
    x, u, slope : (N,) arrays
        Node, deflection (mm) and slope u'.
    constraints : (M + 1, 2) array
        Depth and y of the constraint points, mm; point 0 is first contact.
    tip_track : (M + 1, 2) array
        Deflection (mm) and slope of the tip as it stood at each constraint point.
    status : str
        "converged", or why it is not; then what was not reached is NaN, the whole shape with it.
    iterations : int
        Newton iterations over all steps.
    scales : (3,) array
        What validity is measured by: see `validity.compute_scales`; infinite where there is no tissue.
    """

    x: Floats
    u: Floats
    slope: Floats
    constraints: Floats
    tip_track: Floats
    status: Status
    iterations: int
    scales: Floats = field(default_factory=make_unknown_scales)

    @cached_property
    def validity(self) -> Validity:
        """How far the solution keeps within the model's assumptions; NaN where there is no solution."""
        return compute_validity(self)

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
        """Depth and deflection of the tip as it stood at each constraint point, (M + 1, 2) mm."""
        return np.column_stack((self.constraints[:, 0], self.tip_track[:, 0]))

    @property
    def tip_lateral(self) -> float:
        """The y of the tip in C, mm, where `compute_positions` has it."""
        return float(compute_positions(self, self.x[-1:])[0, 1])


def compute_positions(shape: NeedleShape, s: Floats) -> Floats:
    """Return the points (K, 2) of the needle in C, mm, at given beam coordinates.

    u' is the rotation of the needle's section: x(s) = integral of cos u', y(s) = integral of sin u', from the
    base, which stands at its own beam coordinate and deflection. The needle keeps its length, and the tip
    lags a little behind its depth.

    Parameters
    ----------
    s : (K,) array
        Beam coordinates, mm: 0 at the entry, `shape.depth` at the tip, negative before the tissue.

    Returns
    -------
    (K, 2) array
        x and y, mm.

    Raises
    ------
    ModelError
        If a coordinate lies outside the needle.
    """
    wanted = np.ascontiguousarray(s, dtype=np.float64)
    # The last of a row of equidistant coordinates may lie beyond the tip by rounding.
    slack = 1e-9 * max(1.0, shape.depth)
    if wanted.min() < shape.x[0] - slack or wanted.max() > shape.x[-1] + slack:
        raise ModelError(
            f"beam coordinates {wanted.min():g} ... {wanted.max():g} mm leave the needle",
            expected=f"{shape.x[0]:g} ... {shape.x[-1]:g} mm",
        )
    x, u, slope = (np.ascontiguousarray(part)[None] for part in (shape.x, shape.u, shape.slope))
    found: Floats = native.compute_positions(x, u, slope, wanted)[0]
    return found


def map_beam_points(shape: NeedleShape, points: Floats) -> Floats:
    """Return points (K, 2), given by beam coordinate and deflection, in the coordinates of
    `compute_positions`.

    Each point moves with the point of the needle at its beam coordinate: its distance from the needle, along
    y, is then the e of the model.
    """
    s = np.ascontiguousarray(points[:, 0])
    beside = points[:, 1] - native.compute_deflections(shape.x, shape.u, shape.slope, s)
    return compute_positions(shape, s) + np.column_stack((np.zeros(len(s)), beside))


def sample_inserted_points(shape: NeedleShape, stations: int = 101) -> Floats:
    """Return points (stations, 2) in C at equal fractions of the inserted arc length, from entry to tip."""
    return compute_positions(shape, np.linspace(0.0, shape.depth, stations))
