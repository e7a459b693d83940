"""How far needles are from where their bevels and their curvatures lead them."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
import scipy

from needlefit.arrays import Floats
from needlefit.datasets.columns import CURVATURE_COLUMNS
from needlefit.datasets.compared import (
    MAX_NAMED_INSERTIONS,
    MIN_BEND_SLOPE,
    SIGNIFICANT_SD,
    compute_deflection_sd,
    compute_plane_sd,
)
from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.datasets.layers import Checked, ListedInsertion
from needlefit.geometry.frames import normalize
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

#: smallest distance of tips from the planes of their curves that counts, as a fraction of the deflection
#: (rms)
MIN_TWIST = 0.05


def measure_out_of_plane(dataset: Dataset) -> list[tuple[str, float, float]]:
    """Return how far each needle is from where its bevel leads it: mm, standard deviations; worst first.

    See `measure_aside`. The plane of a free shape is the one nearest to it. None of tip tracks, and of tips
    that were not measured out of their planes.
    """
    in_space = [
        insertion
        for insertion in dataset.insertions
        if not insertion.in_tracker_frame and insertion.directions == 2
    ]
    gaps = [
        (insertion.id, measure_aside(insertion), compute_deflection_sd(insertion, dataset.noise))
        for insertion in in_space
    ]
    return sorted(((name, gap, gap / (sd or math.nan)) for name, gap, sd in gaps), key=lambda row: -row[2])


def measure_aside(insertion: Insertion, handedness: float = 1.0) -> float:
    """Return how far a needle is from the directions across it in which its bevel leads it, mm.

    Without turns that is the tip's distance from the bevel's plane: sides are judged elsewhere. Else the
    needle lies at each turn, and at its tip, between the directions that the bevel has faced up to there,
    whatever layers it meets; the greatest distance counts. `handedness` -1: of turns of the opposite sign.
    """
    if not insertion.turns:
        return abs(float(insertion.points[-1, 2]))
    depths, rolls = np.array([(0.0, 0.0), *insertion.turns]).T
    angles = np.radians(handedness * rolls)
    faced = insertion.side * np.array([np.cos(angles), np.sin(angles)])
    places = enumerate(_find_across(insertion, [*depths[1:], insertion.depth]), start=1)
    return max(float(scipy.optimize.nnls(faced[:, :count], place)[1]) for count, place in places)


def _find_across(insertion: Insertion, depths: Sequence[float]) -> Floats:
    """Return y and z (n, 2) of the needle at depths along it, mm."""
    along = insertion.measure_arc("space")
    along = along * (insertion.depth / along[-1])
    return np.column_stack([np.interp(depths, along, coordinates) for coordinates in insertion.points.T[1:]])


def find_plane_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions that are not where their bevels lead them, and what would.

    Without any it names those whose tips are far out of the planes nearest to their own curves.
    """
    listed, noise = checked.curves, checked.noise
    aside = _find_aside([entry for entry in listed if entry.insertion.is_posed], noise)
    if not aside:
        if twisted := _find_twisted([entry.insertion for entry in listed], noise):
            problem = f"{join_names(twisted, MAX_NAMED_INSERTIONS)} bend in no plane"
            fix = "if the needle turned on its way, state its turns by `insertions.turns`"
            yield ResultWarning("bevel_plane", problem, where=listed[0].where, fix=fix)
        return
    most = max(measure_aside(entry.insertion) for entry in aside)
    problem = f"needles are up to {most:.1f} mm from where their bevels lead them, beyond their errors: "
    fix = f'{_name_bevel([entry.insertion for entry in aside])}; `compared = "space"` in the study or fit '
    yield ResultWarning(
        "bevel_plane",
        problem + join_names([entry.insertion.id for entry in aside], MAX_NAMED_INSERTIONS),
        where=aside[0].where,
        fix=f"{fix}compares them there",
    )


def find_curvature_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions whose stated curvatures bend them away from their tips."""
    listed, noise, against = checked.curves, checked.noise, dict[str, list[str]]()
    for insertion in (entry.insertion for entry in listed):
        if insertion.curvature is None:
            continue
        s, *curvatures, _ = insertion.curvature[np.argsort(insertion.curvature[:, 0])].T
        places = np.linspace(0.0, insertion.depth, len(s) * 20)  # from the tip; the entry is straight along x
        least = max(
            SIGNIFICANT_SD * compute_deflection_sd(insertion, noise), MIN_BEND_SLOPE * insertion.depth
        )
        (tip,) = _find_across(insertion, [insertion.depth])
        for column, curvature, away in zip(CURVATURE_COLUMNS[2:4], curvatures, tip, strict=True):
            led = np.trapezoid(places * np.interp(places, s, curvature), places)
            if led * away < 0 and min(abs(led), abs(away)) > least:
                against.setdefault(column, []).append(insertion.id)
    for column, names in against.items():
        problem = f"`{column}` bends {join_names(names, MAX_NAMED_INSERTIONS)} away from the measured tips"
        fix = "check its sign: curvatures are toward +y and +z of a bevel with a roll of 0"
        yield ResultWarning("curvature", problem, where=listed[0].where, fix=fix)


def _find_aside(listed: Sequence[ListedInsertion], noise: Noise) -> list[ListedInsertion]:
    """Return the insertions that errors do not bring to where their bevels lead them.

    Of many needles one is beyond `SIGNIFICANT_SD` by chance: any of them is so as rarely as one would be.
    Those with turns, whose rolls have errors, are judged together too: they follow one convention.
    """
    ratios = []
    for insertion in (entry.insertion for entry in listed):
        sd = max(compute_plane_sd(insertion, noise), MIN_BEND_SLOPE * insertion.depth / SIGNIFICANT_SD)
        ratios.append(measure_aside(insertion) / sd)
    turned = [ratio for ratio, entry in zip(ratios, listed, strict=True) if entry.insertion.turns]
    rare = float(scipy.special.chdtrc(1, SIGNIFICANT_SD**2))
    single = math.sqrt(scipy.special.chdtri(1, rare / max(1, len(listed))))
    together = math.sqrt(scipy.special.chdtri(len(turned) or 1, rare) / (len(turned) or 1))  # rms
    limit = together if np.sum(np.square(turned)) > together**2 * len(turned) else single
    pairs = zip(listed, ratios, strict=True)
    return [entry for entry, ratio in pairs if ratio > (limit if entry.insertion.turns else single)]


def _name_bevel(aside: Sequence[Insertion]) -> str:
    """Return what would lead needles to where they are: turns, or rolls and a bevel direction."""
    if all(
        insertion.turns and measure_aside(insertion, -1.0) < measure_aside(insertion) / 2
        for insertion in aside
    ):
        return "check the sign of `bevel_roll_deg` of the turns: right-handed about x"
    rolls, directions = [], []
    for insertion in aside:
        (last,) = insertion.side * _find_across(insertion, [insertion.depth])
        rolls.append(f"{math.degrees(math.atan2(last[1], last[0])):.0f} ({insertion.id})")
        directions.append(normalize(insertion.frame.rotation[:, 1:] @ last))
    mean = ", ".join(f"{x:z.2f}" for x in normalize(np.mean(directions, axis=0)).round(2))
    fix = "check the bevel direction, the turns and the frame; tips lie toward rolls of "
    return f"{fix}{join_names(rolls, MAX_NAMED_INSERTIONS)} degrees, on the mean toward {mean}"


def _find_twisted(insertions: Sequence[Insertion], noise: Noise) -> list[str]:
    """Return the needles without turns that bend in no plane; none unless they do so together (rms)."""
    unturned, twists = [insertion for insertion in insertions if not insertion.turns], dict[str, float]()
    for insertion in unturned:  # how far the tip is out of the plane nearest to the whole curve, mm
        points = insertion.centerline - insertion.centerline.mean(axis=0)
        twists[insertion.id] = abs(float(points[-1] @ np.linalg.svd(points, full_matrices=False)[2][2]))
    errors = SIGNIFICANT_SD * math.hypot(noise.point_sd, noise.correlated_sd)
    away, bend = math.hypot(*twists.values()), math.hypot(*(insertion.deflection for insertion in unturned))
    if not errors or away <= max(errors * math.sqrt(len(unturned)), MIN_TWIST * bend):
        return []
    return [name for name, twist in twists.items() if twist > errors]
