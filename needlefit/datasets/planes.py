"""How far needles leave the planes of their bevels; whether they are compared in one plane or in space."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, Noise, TipTrack
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.errors import ConfigError
from needlefit.geometry.frames import normalize
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

SIGNIFICANT_SD = 3.0  # standard deviations beyond which a bend is not a measurement error
# Least bend over depth that counts: entry directions are hardly known better than 0.3 degrees.
MIN_BEND_SLOPE = 0.005
MIN_TWIST = 0.05  # of tips out of the planes of their curves, as part of the deflection, rms
MIN_SAME_DIRECTION = 0.95  # length of the mean of unit vectors from which they are one direction
MAX_NAMED_INSERTIONS = 8  # number of insertions that a warning names
PLANAR_TURN_SINE = 1e-6  # sine of a turn up to which it is one by 0 or 180 degrees


def compute_deflection_sd(insertion: Insertion, noise: Noise) -> float:
    """Return the standard deviation of a tip across the needle by points and pose, mm."""
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    pose = math.hypot(shift, insertion.pose_angle_sd * insertion.depth)
    return math.hypot(pose, noise.point_sd, noise.correlated_sd)


def compute_plane_sd(insertion: Insertion, noise: Noise) -> float:
    """Return the standard deviation of a tip out of the plane of its bevel, by the roll too, mm."""
    bent = float(np.abs(insertion.planar[:, 1]).max())
    return math.hypot(compute_deflection_sd(insertion, noise), insertion.roll_sd * bent)


def turns_out_of_plane(insertion: Insertion) -> bool:
    """Whether the bevel was turned on the way by anything but half turns."""
    return any(abs(math.sin(math.radians(roll))) > PLANAR_TURN_SINE for _, roll in insertion.turns)


def leaves_plane(insertion: Insertion, noise: Noise) -> bool:
    """Whether a needle was turned out of its plane, or left it by more than its errors, the roll's too.

    A run of a tip track leaves it where its guide does.
    """
    if isinstance(insertion, TipTrack):
        turned = insertion.guide_z is not None and turns_out_of_plane(insertion)
        return turned or insertion.guided_along_z
    if turns_out_of_plane(insertion):
        return True
    away, sd = abs(float(insertion.out_of_plane[-1])), compute_plane_sd(insertion, noise)
    return away > max(SIGNIFICANT_SD * sd, MIN_BEND_SLOPE * insertion.depth)


def set_planes(dataset: Dataset, insertions: Sequence[Insertion], stated: int | None) -> Dataset:
    """Return the dataset with the number of planes in which its needles are simulated and compared.

    It is the `stated` one; where that is None, 2 if any of the `insertions` leaves its plane. In one plane a
    turn counts as the half turn, or none, that is nearest to it, and what a tracker read along z does not.

    Raises ConfigError if two are stated for shapes of unknown pose, or tips that were tracked in one plane.
    """
    flat = any(isinstance(one, TipTrack) and one.guide_z is None for one in insertions)
    if stated == 2 and (flat or dataset.pose == "free"):
        raise ConfigError(
            f"the needles of {dataset.name} have no known " + ("place along z" if flat else "pose"),
            key="planes",
            expected="1" + (", or tip_z_mm of every run" if flat else ": their plane is that of their shape"),
        )
    planes = stated or 1
    if stated is None and not flat and dataset.pose != "free":
        planes += any(leaves_plane(one, dataset.noise) for one in insertions)
    if planes == 2:
        return replace(dataset, planes=2)
    kept = (_project_turns(one) if one.turns else one for one in dataset.insertions)
    kept = (replace(one, guide_z=None) if isinstance(one, TipTrack) else one for one in kept)
    return replace(dataset, insertions=tuple(kept))


def _project_turns(insertion: Insertion) -> Insertion:
    turns = [(depth, math.cos(math.radians(roll))) for depth, roll in insertion.turns]
    halves = ((depth, 0.0 if cosine > -PLANAR_TURN_SINE else 180.0) for depth, cosine in turns)
    return replace(insertion, turns=tuple(halves))


def measure_out_of_plane(dataset: Dataset) -> list[tuple[str, float, float]]:
    """Return how far each tip is out of the plane of its bevel, mm, and in standard deviations; worst first.

    That of a free shape is the plane nearest to it. None of tip tracks and of needles that were turned.
    """
    known = [one for one in dataset.insertions if dataset.pose != "tracker" and not one.turns]
    sds = [compute_deflection_sd(one, dataset.noise) or math.nan for one in known]
    away = [abs(float(one.out_of_plane[-1])) for one in known]
    found = [(one.id, gap, gap / sd) for one, gap, sd in zip(known, away, sds, strict=True)]
    return sorted(found, key=lambda one: -one[2])


def find_plane_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions whose tips leave the planes of their bevels.

    It proposes the direction of side 1 that fits their tips, and says whether one fits all. Without any it
    names those whose tips are far out of the planes nearest to their own curves.
    """
    tips: dict[str, Floats] = {}  # across the needle, turned to side 1, in the world
    places, worst = [], 0.0
    for insertion, where in ((one.insertion, one.where) for one in listed):
        has_plane = insertion.pose_source != "none" and not turns_out_of_plane(insertion)
        away = abs(float(insertion.out_of_plane[-1])) if has_plane else 0.0
        # of a needle that was turned the roll was stated, with its error
        compute_sd = compute_plane_sd if insertion.turns else compute_deflection_sd
        errors = SIGNIFICANT_SD * compute_sd(insertion, noise)
        if away > max(errors, MIN_BEND_SLOPE * insertion.depth):
            across = np.array([0.0, insertion.planar[-1, 1], insertion.out_of_plane[-1]])
            tips[insertion.id] = insertion.side * insertion.frame.rotation @ across
            places.append(where)
            worst = max(worst, away)
    if tips:
        shown = [
            f"{', '.join(f'{x:z.2f}' for x in normalize(tip).round(2))} ({id_})" for id_, tip in tips.items()
        ]
        mean = np.mean([normalize(tip) for tip in tips.values()], axis=0)
        if np.linalg.norm(mean) > MIN_SAME_DIRECTION:
            shown = [", ".join(f"{x:z.2f}" for x in normalize(mean).round(2))]
        out, fits = (join_names(one, MAX_NAMED_INSERTIONS) for one in ([*tips], shown))
        what = (
            f"tips are out of the planes of their bevels, by up to {worst:.1f} mm, more than "
            f"{SIGNIFICANT_SD:g} standard deviations of points and pose: {out}"
        )
        fix = f"check the bevel direction and the frame; the direction {fits} fits"
        fix += "; state turns of the bevel by `insertions.turns`"
        yield ResultWarning("bevel_plane", what, places[0], fix)
        return
    own = [(_measure_twist(one.insertion), one) for one in listed if not one.insertion.turns]
    squares = [(away**2, one.insertion.deflection**2) for away, one in own]
    away, bend = np.sqrt(np.mean(squares, axis=0)) if squares else (0.0, 0.0)
    errors = SIGNIFICANT_SD * math.hypot(noise.point_sd, noise.correlated_sd)
    if errors and away > max(errors, MIN_TWIST * bend):
        names = [one.insertion.id for twist, one in own if twist > errors]
        what = f"{join_names(names, MAX_NAMED_INSERTIONS)} bend in no plane, by {away:.2g} mm at tips (rms)"
        fix = "check whether the needle turned on its way, and state its turns by `insertions.turns`"
        yield ResultWarning("bevel_plane", what, listed[0].where, fix)


def _measure_twist(insertion: Insertion) -> float:
    """Return how far the tip is out of the plane nearest to the whole curve, mm."""
    points = insertion.centerline - insertion.centerline.mean(axis=0)
    return abs(float(points[-1] @ np.linalg.svd(points, full_matrices=False)[2][2]))
