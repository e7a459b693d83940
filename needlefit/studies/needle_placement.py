"""Place measured and fitted needles in the coordinates of their scan, with simultaneous 95 % bands.

The band of a held-out needle is where it was predicted to be measured; without a prediction there is none.
That of a needle that was fitted to holds 95 % of the needles of certified draws of the posterior: neither
the noise of the measured points nor what the model misses is in it.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Dataset, Insertion, find_pose
from needlefit.geometry.frames import Placement
from needlefit.grouping import group_values
from needlefit.inference.compared_points import Curve, align
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import PreparedModel, predict
from needlefit.inference.likelihood.observations import SimulatedCurve, select_points
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem
from needlefit.mechanics.batch import compute_batch_positions
from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.reporting.needles_in_scan import Band, NeedleInScan

NEEDLE_POINTS = 51  # points of a fitted needle and of its band
BAND_PROBABILITY = 0.95


def place_needles(
    problem: Problem,
    fold: Fold,
    fit: Fit,
    draws: Draws | None = None,
    predicted: Sequence[Mapping[str, Any]] = (),
    jobs: int = 1,
    *,
    fitted: bool = True,
    curves: Mapping[str, Curve] = MappingProxyType({}),
) -> Iterator[NeedleInScan]:
    """Yield every insertion that a fold holds out, before them, if wanted, those that were `fitted` to.

    `predicted` are the rows of the table "bands", `curves` the predicted needles by insertion; without one it
    is that of the fit. Tip tracks were never in a scan: of them there is none.
    """
    bands = group_values((row["insertion"], row) for row in predicted if row["fold"] == fold.name)
    for role, insertions in (("tune", fold.tune if fitted else ()), ("validate", fold.validate)):
        for insertion in (insertion for insertion in insertions if not insertion.in_tracker_frame):
            placement, band = Placement(insertion.frame, insertion.patient), None
            curve = curves.get(insertion.id) if role == "validate" else None
            points = _place_needle(problem, insertion, curve or _simulate_fit(problem, insertion, fit))
            if role == "validate":
                band = _place_predicted_band(insertion, placement, bands.get(insertion.id, ()))
            elif points is not None and draws is not None and draws.certified is not None:
                band = _place_band_of_draws(problem, insertion, placement, points[:, 0], draws.thetas, jobs)
            yield NeedleInScan(
                insertion.id,
                fold.name,
                role,
                measured=insertion.patient.to_local(insertion.centerline),
                diameter=insertion.needle.outer_diameter or DEFAULT_DIAMETER_MM,
                fitted=None if points is None else placement.to_patient(points),
                band=band,
            )


def _simulate_fit(problem: Problem, insertion: Insertion, fit: Fit) -> Curve | None:
    """Return the needle of a fit; None without a solution."""
    shape = predict(fit.values, problem.medium, insertion)
    return SimulatedCurve(shape, insertion) if shape.converged else None


def _place_needle(problem: Problem, insertion: Insertion, curve: Curve | None) -> Floats | None:
    """Return a needle (K, 3) in C, as `place_points`; None without one."""
    s = _choose_places(problem, insertion)
    return None if curve is None else place_points(problem.dataset, insertion, s, curve(s))


def _choose_places(problem: Problem, insertion: Insertion) -> Floats:
    """Return the beam coordinates (K,), mm, at which a needle is drawn."""
    dataset = problem.dataset
    return select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s


def place_points(dataset: Dataset, insertion: Insertion, s: Floats, points: Floats) -> Floats:
    """Return points (K, 3) of a simulated needle at `s` (K,), mm, as it lies in C.

    It lies on the measured one as far as the pose is not known. `s` are those of `select_points`.
    """
    pose = find_pose(dataset.pose, insertion)
    if pose == "known":
        return points
    if pose == "free":
        along = insertion.measure_arc("plane")
        places = along[-1] - (insertion.depth - s)
        measured = np.column_stack([np.interp(places, along, axis) for axis in insertion.points.T[:2]])
    else:
        goal = select_points(dataset.pose, dataset.drop_proximal, insertion, len(s), dataset.compared)
        measured = goal.target
    placed, compared = points.copy(), slice(measured.shape[1])
    placed[:, compared] = align(pose, points[:, compared], measured)
    return placed


def _place_predicted_band(
    insertion: Insertion, placement: Placement, rows: Sequence[Mapping[str, Any]]
) -> Band | None:
    """Return the band of what was predicted to be measured; None without a prediction.

    Where only the shape is known, predictions stand in a frame of their own: the band keeps its distance from
    the measured needle.
    """
    if not rows:
        return None
    x, measured, *heights = np.array(
        [[row[f"{name}_mm"] for name in ("x", "measured", "low_95", "median", "high_95")] for row in rows]
    ).T
    shift = np.interp(x, *insertion.points.T[:2]) - measured
    across = np.array([row.get("median_z_mm", 0.0) for row in rows])
    low, middle, high = (placement.to_patient(np.column_stack([x, y + shift, across])) for y in heights)
    return Band(low, middle, high, "predicted")


def _place_band_of_draws(
    problem: Problem, insertion: Insertion, placement: Placement, x: Floats, thetas: Floats, jobs: int
) -> Band | None:
    """Return the band over the needles of draws, at the fitted needle's x (K,); None where none is solved."""
    sets = [problem.parameters.values(theta) for theta in thetas]
    (shapes,) = PreparedModel(problem.medium, [insertion]).simulate(sets, jobs)
    s = _choose_places(problem, insertion)
    needles = compute_batch_positions(shapes, s)[shapes.converged]  # (B, K, 3)
    if not len(needles):
        return None
    aligned = np.array([place_points(problem.dataset, insertion, s, needle) for needle in needles])
    across, bands = np.median(aligned[..., 2], axis=0), find_bands(aligned[..., 1])
    below, above = bands.ends(BAND_PROBABILITY)
    low, middle, high = (
        placement.to_patient(np.column_stack([x, y, across])) for y in (below, bands.median, above)
    )
    return Band(low, middle, high, "posterior")
