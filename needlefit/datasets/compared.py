"""Whether needles are compared in one plane or in space: as stated, or by whether they leave their planes."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.errors import ConfigError
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.base import Compared

SIGNIFICANT_SD = 3.0  # number of standard deviations beyond which a bend is not a measurement error
#: smallest log odds of the best hypothesis against the next: a factor of 20 is strong evidence (R. E. Kass,
#: A. E. Raftery, J. Am. Stat. Assoc. 90 (1995) 773)
MIN_LOG_ODDS = math.log(20.0)
# smallest bend over depth that counts: entry directions are hardly known better than 0.3 degrees
MIN_BEND_SLOPE = 0.005
MAX_NAMED_INSERTIONS = 8  # largest number of insertions that a warning names
PLANAR_TURN_SINE = 1e-6  # largest |sine| of a turn that counts as one by 0 or 180 degrees


def compute_entry_sd(insertion: Insertion, noise: Noise) -> float:
    """Return the standard deviation of a first point, along any axis, by points and pose, mm."""
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    return math.hypot(shift, noise.of(insertion).point_sd, noise.correlated_sd)


def compute_deflection_sd(insertion: Insertion, noise: Noise) -> float:
    """Return the standard deviation of a tip across the needle by points and pose, mm."""
    return math.hypot(compute_entry_sd(insertion, noise), insertion.pose_angle_sd * insertion.depth)


def compute_plane_sd(insertion: Insertion, noise: Noise) -> float:
    """Return the standard deviation of a tip out of the plane of its bevel, by the roll too, mm."""
    bent = float(np.abs(insertion.points[:, 1]).max())
    return math.hypot(compute_deflection_sd(insertion, noise), insertion.roll_sd * bent)


def turns_out_of_plane(insertion: Insertion) -> bool:
    """Whether the bevel was turned on the way by anything but half turns."""
    return any(abs(math.sin(math.radians(roll))) > PLANAR_TURN_SINE for _, roll in insertion.turns)


def leaves_plane(insertion: Insertion, noise: Noise) -> bool:
    """Whether a needle was turned out of its plane, or left it by more than its errors, the roll's too.

    So do stated curvatures along z. Of an unknown pose no plane is known: then the guide must have left it.
    """
    guide = insertion.guide
    if insertion.directions == 1:
        return False
    if turns_out_of_plane(insertion) or (guide is not None and guide.moved_along_z):
        return True
    if not insertion.is_posed:
        return False
    if (read := insertion.curvature) is not None:
        sds = np.hypot(read[:, 3], insertion.roll_sd * np.abs(read[:, 1]).max())
        if np.mean((read[:, 2] / sds) ** 2) > SIGNIFICANT_SD**2:
            return True
    away, sd = abs(float(insertion.points[-1, 2])), compute_plane_sd(insertion, noise)
    return away > max(SIGNIFICANT_SD * sd, MIN_BEND_SLOPE * insertion.depth)


def set_compared(
    dataset: Dataset,
    insertions: Sequence[Insertion],
    stated: Compared | None,
    torsional_friction: float | None = None,
) -> Dataset:
    """Return the dataset with where its needles are simulated and compared: in their planes or in space.

    It is what is `stated`; where that is None, space if any of the `insertions` leaves its plane, or was
    turned against `torsional_friction`: while the tip follows the hub, even a half turn bends the needle to
    the side. In the plane a turn counts as the half turn, or none, that is nearest to it, and what a tracker
    read along z does not.

    Raises ConfigError if space is stated for shapes of unknown pose, or tips that were tracked along y alone,
    or the plane for needles that are turned against friction.
    """
    if torsional_friction and any(insertion.turns for insertion in insertions):
        if stated == "plane":
            raise ConfigError(
                "torsional friction leads needles that were turned out of their planes",
                expected='"space", or no torsional_friction_n of the medium',
            )
        stated = "space"
    flat = any(insertion.directions == 1 for insertion in insertions)
    if stated == "space" and (flat or dataset.pose == "free"):
        raise ConfigError(
            f"the needles of {dataset.name} have no known " + ("place along z" if flat else "pose"),
            key="compared",
            expected='"plane"'
            + (", or tip_z_mm of every run" if flat else ": their plane is that of their shape"),
        )
    is_space_known = not flat and dataset.pose != "free"
    if (
        stated is None
        and is_space_known
        and any(leaves_plane(insertion, dataset.noise) for insertion in insertions)
    ):
        stated = "space"
    if stated == "space":
        rolled = (
            replace(insertion, curve_roll=find_curve_roll(insertion)) if insertion.turns else insertion
            for insertion in dataset.insertions
        )
        return replace(dataset, insertions=tuple(rolled), compared="space")
    kept = (_project_turns(insertion) if insertion.turns else insertion for insertion in dataset.insertions)
    return replace(dataset, insertions=tuple(map(_flatten_guide, kept)))


def describe_compared(dataset: Dataset) -> str:
    """Return where needles are compared and why, where that was not stated; empty without any doubt."""
    if dataset.compared == "space":
        return 'needles are fitted in space, since some leave their planes (else: `compared = "plane"`)'
    if dataset.pose == "known" and "bevel_plane" in {warning.kind for warning in dataset.warnings}:
        return (
            "needles are fitted in one plane: errors explain what is out of it "
            '(`compared = "space"`: in space)'
        )
    return ""


def find_left_planes(
    dataset: Dataset, insertions: Sequence[Insertion], stated: Compared | None, where: str
) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions that leave the planes in which they are to be compared."""
    is_plane_stated = stated == "plane" and dataset.pose == "known"
    left = sorted(
        {
            insertion.id
            for insertion in insertions
            if is_plane_stated and insertion.is_posed and leaves_plane(insertion, dataset.noise)
        }
    )
    if left:
        named = join_names(left, MAX_NAMED_INSERTIONS)
        problem = f"compared in the plane of their bevels, which they leave: {named}"
        if any(insertion.curvature is not None for insertion in insertions):
            problem += ", and by their curvatures along y alone"
        yield ResultWarning("bevel_plane", problem, where, 'leave `compared` out, or write "space"')


def find_curve_roll(insertion: Insertion) -> float:
    """Return the roll about x of the plane in which a curve without mechanics bends, rad, from the bevel's.

    There the tip of a curve of constant curvature would end whose direction follows the turns of the bevel.
    """
    starts, rolls = np.array([(0.0, 0.0), *insertion.turns]).T
    # how far a unit of curvature between two turns moves the tip
    moved = -np.diff(0.5 * (insertion.depth - starts) ** 2, append=0.0)
    return float(np.angle(moved @ np.exp(1j * np.radians(rolls))))


def _flatten_guide(insertion: Insertion) -> Insertion:
    """Return an insertion under a guide as if that had not moved along z, nor anything been read there."""
    if insertion.guide is None:
        return insertion
    return replace(insertion, guide=insertion.guide.flatten(), directions=1)


def _project_turns(insertion: Insertion) -> Insertion:
    turns = [(depth, math.cos(math.radians(roll))) for depth, roll in insertion.turns]
    halves = ((depth, 0.0 if cosine > -PLANAR_TURN_SINE else 180.0) for depth, cosine in turns)
    return replace(insertion, turns=tuple(halves))
