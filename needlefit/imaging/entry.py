"""Find the needle's pose at first contact: from the stage, or from the shaft outside the tissue.

The final tangent at the entry is never used: by then the tissue has moved the needle there. Outside the
tissue nothing loads the shaft: from where it is clamped (its base, or a guide) to the entry it is the axis on
which it was pushed, plus a cubic that the tissue's pull at the entry bends,

    q(s) = q0 + q1 s + d h0(x) + g L h1(x),     x = 1 + s / L,   h0 = 3 x^2 - 2 x^3,   h1 = x^3 - x^2,

s from the entry (s < 0 outside), L the free length, d and g what the entry moved and turned. q0, q1 are the
pose; d and g take priors (`[entry] entry_shift_sd_mm, entry_tilt_sd_deg`), since a short shaft hardly
separates them from the axis; the deviation of the pose includes this.
"""

from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.reconstruction import EntryPose
from needlefit.imaging.registration.register import Registration, target_covariance
from needlefit.imaging.scan import StagePose

MIN_SHAFT_LENGTH_MM = 10.0
"""Length of shaft outside the tissue, mm, below which no axis is drawn through it."""

SHAFT_CLEARANCE_MM = 1.0
"""The shaft is used up to this far from the entry, mm, where the surface still shows in it."""

CORRELATION_LENGTH_MM = 7.5
"""Length along the needle over which errors of the traced axis hang together, mm: half a knot's distance."""

SURFACE_REACH_MM = 80.0
"""How far from the place where the needle enters the axis is followed to the tissue's surface, mm."""

MAX_AXIS_DISAGREEMENT_SD = 10.0
"""Deviations from which on the stage's axis and the shaft's are not one needle's."""

MAX_ENTRY_DISTANCE_MM = 5.0
"""Greatest distance of a centreline's first point from the entry, mm; as datasets demand it."""


@dataclass(frozen=True)
class OutsideShaft:
    """The part of the needle outside the tissue.

    Attributes
    ----------
    points : (N, 3) array
        World, base side first, mm.
    sd : (N,) array
        In any one direction across, mm.
    s : (N,) array
        From the entry along the needle, mm; all below zero.
    free : float
        Length from where it is clamped to the entry, mm.
    bend, turn : float
        Prior deviations of what the tissue did to it at the entry, mm and rad.
    """

    points: Floats
    sd: Floats
    s: Floats
    free: float
    bend: float
    turn: float


@dataclass(frozen=True)
class Disagreement:
    """The difference of two axes at first contact: distance (mm) and angle (rad), each with its deviation."""

    offset: float
    offset_sd: float
    turn: float
    turn_sd: float

    @property
    def worst(self) -> float:
        """The larger of both differences, in standard deviations."""
        return max(self.offset / self.offset_sd, self.turn / self.turn_sd)

    @property
    def sentence(self) -> str:
        """The difference in words."""
        turn, turn_sd = np.degrees([self.turn, self.turn_sd])
        return (
            f"the shaft outside the tissue stands {self.offset:.2f} +- {self.offset_sd:.2f} mm beside the "
            f"stage's axis and is turned by {turn:.2f} +- {turn_sd:.2f} degrees against it"
        )


def pose_from_stage(stage: StagePose, registration: Registration | None, patient_entry: Floats) -> EntryPose:
    """Return the pose that the stage states, with its deviations against the centreline.

    The scan brings the registration's error with it: its shift at the entry (`patient_entry` (3,), LPS) and
    its turn, in any one direction across.
    """
    shift, turn, along = 0.0, 0.0, 0.0
    if registration is not None:
        error = target_covariance(registration, patient_entry[None])[0]
        shift, along = (
            _variance_across(error, stage.direction),
            float(stage.direction @ error @ stage.direction),
        )
        turn = _variance_across(registration.covariance[:3, :3], stage.direction)
    return EntryPose(
        origin=stage.entry,
        direction=stage.direction,
        source="stage",
        shift_sd=float(np.hypot(stage.shift_sd, np.sqrt(shift))),
        angle_sd=float(np.hypot(stage.angle_sd, np.sqrt(turn))),
        along_sd=float(np.hypot(stage.shift_sd, np.sqrt(along))),
    )


def usable_length(shaft: OutsideShaft) -> float:
    """Return the usable length of the shaft, mm."""
    use = shaft.s[shaft.s < -SHAFT_CLEARANCE_MM]
    return float(np.ptp(use)) if len(use) else 0.0


def pose_from_shaft(shaft: OutsideShaft, along_sd: float) -> EntryPose:
    """Return the pose of the axis on which the shaft was pushed; its origin is the point where that axis
    enters.

    Raises
    ------
    DataError
        If too little of the shaft shows.
    """
    use = shaft.s < -SHAFT_CLEARANCE_MM
    if usable_length(shaft) < MIN_SHAFT_LENGTH_MM:
        raise DataError(
            f"{usable_length(shaft):.1f} mm of the shaft show outside the tissue, too few to draw its axis",
            where="entry pose",
            expected=f"at least {MIN_SHAFT_LENGTH_MM:g} mm, or the pose of the stage",
            fix="state the stage (entry_x_mm ... pose_angle_sd_deg), or scan more of the needle",
        )
    s, points, sd = shaft.s[use], shaft.points[use], shaft.sd[use]
    chord = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    sides = np.column_stack([make_normal(chord), np.cross(chord, make_normal(chord))])  # (3, 2)
    # only displacements across the chord are fitted; s gives the position along it
    line = points[-1] + (s - s[-1])[:, None] * chord
    x = 1 + s / shaft.free
    design = np.column_stack([np.ones_like(s), s, 3 * x**2 - 2 * x**3, shaft.free * (x**3 - x**2)])
    # errors of the traced axis are correlated; a tenth is independent, which keeps the matrix invertible
    noise = np.outer(sd, sd) * np.exp(-np.abs(s[:, None] - s) / CORRELATION_LENGTH_MM) + np.diag(
        (0.1 * sd) ** 2
    )
    whitened = np.linalg.solve(noise, design)
    prior = np.diag([0.0, 0.0, shaft.bend**-2, shaft.turn**-2])
    covariance = np.linalg.inv(design.T @ whitened + prior)
    fitted = covariance @ whitened.T @ ((points - line) @ sides)  # (4, 2)
    direction = chord + sides @ fitted[1]
    origin = points[-1] - s[-1] * chord + sides @ fitted[0]
    shift_sd, angle_sd = np.sqrt(np.diag(covariance)[:2])
    return EntryPose(
        origin, direction / np.linalg.norm(direction), "shaft", float(shift_sd), float(angle_sd), along_sd
    )


def compare_poses(stage: EntryPose, shaft: EntryPose) -> Disagreement:
    """Return the difference of the shaft outside the tissue from the stage's axis, at first contact."""
    apart = shaft.origin - stage.origin
    offset = apart - (apart @ stage.direction) * stage.direction
    turn = float(np.arccos(np.clip(stage.direction @ shaft.direction, -1, 1)))
    return Disagreement(
        offset=float(np.linalg.norm(offset)),
        offset_sd=float(np.hypot(stage.shift_sd, shaft.shift_sd)),
        turn=turn,
        turn_sd=float(np.hypot(stage.angle_sd, shaft.angle_sd)),
    )


def require_agreement(stage: EntryPose, shaft: EntryPose) -> None:
    """Raise DataError if stage and shaft cannot belong to the same needle."""
    found = compare_poses(stage, shaft)
    if found.worst <= MAX_AXIS_DISAGREEMENT_SD:
        return
    raise DataError(
        found.sentence,
        where="entry pose",
        expected="the axis on which the needle was pushed",
        fix="check entry_x_mm ... entry_dz: their frame (the world of the markers), signs (LPS or RAS), and "
        "the deviations stated; or leave the stage out, and the shaft is taken",
    )


def move_to_surface(pose: EntryPose, surfaces: tuple[Surface, ...]) -> EntryPose:
    """Return the pose with its origin where its axis meets the tissue's own surface (`into = 1`).

    Of several such places the one nearest to the origin counts; where there is none, the origin stays.
    """
    ends = pose.origin + np.outer([-SURFACE_REACH_MM, SURFACE_REACH_MM], pose.direction)
    hits = [find_surface_hits(ends, surface) for surface in surfaces if surface.into == 1]
    arcs = np.concatenate(hits) if hits else np.empty(0)
    if not len(arcs):
        return pose
    nearest = float(arcs[np.argmin(np.abs(arcs - SURFACE_REACH_MM))])
    return replace(pose, origin=ends[0] + nearest * pose.direction)


def find_entry_arc_length(points: Floats, pose: EntryPose) -> float:
    """Return the arc length along `points` (N, 3) at which they cross the plane of first contact.

    Raises
    ------
    DataError
        If the needle never crosses that plane, or far from the place stated.
    """
    along = (points - pose.origin) @ pose.direction
    before = np.flatnonzero((along[:-1] < 0) & (along[1:] >= 0))
    if not len(before):
        raise DataError(
            f"the needle does not pass the entry: it lies {along.min():.1f} to {along.max():.1f} mm from it "
            "along the entry direction",
            where="entry pose",
            expected="an entry between the needle's base and its tip, a direction into the tissue",
            fix="check entry_x_mm ... entry_dz, their frame (the world of the markers), and the sign of "
            "the direction",
        )
    n = int(before[0])
    s = arc_length(points)
    at: float = s[n] - along[n] / (along[n + 1] - along[n]) * (s[n + 1] - s[n])
    away = float(np.linalg.norm(interpolate_at_arc(points, [at])[0] - pose.origin))
    if away > MAX_ENTRY_DISTANCE_MM:
        raise DataError(
            f"the needle crosses the plane of first contact {away:.1f} mm from the entry",
            where="entry pose",
            expected=f"within {MAX_ENTRY_DISTANCE_MM:g} mm of it",
            fix="check the entry pose, the known places of the markers, and that both are in one frame",
        )
    return at


def _variance_across(covariance: Floats, direction: Floats) -> float:
    """Return the variance in any one direction across `direction` (3,)."""
    return float((np.trace(covariance) - direction @ covariance @ direction) / 2)
