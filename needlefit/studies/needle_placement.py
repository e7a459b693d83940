"""Place measured and fitted needles in the coordinates of their scan, with simultaneous 95 % bands.

The band of a held-out needle is where it was predicted to be measured; without a prediction there is none.
That of a needle that was fitted to holds 95 % of the needles of certified draws of the posterior: neither
the noise of the measured points nor what the model misses is in it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Dataset, Insertion, find_pose
from needlefit.geometry.frames import Placement
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.draws import Draws
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import PreparedModel, predict
from needlefit.inference.likelihood.compared_points import align
from needlefit.inference.likelihood.observations import SimulatedCurve, select_points
from needlefit.inference.problem import Problem
from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.reporting.table_files import Row
from needlefit.studies.observations import HeldOutPrediction

NEEDLE_POINTS = 51  # number of points of a fitted needle and of its band
BAND_PROBABILITY = 0.95  # probability inside the band
BAND_CURVES = ("low", "middle", "high")
NOWHERE: Floats = np.empty(0)


#: Of the table "needles": every insertion held out, or, of a single fold, any, point by point in the patient
#: coordinates of its scan (LPS). `role` is "validate" where the fit never saw it, else "tune"; `band_source`
#: of a held-out needle "predicted", else "posterior", "" without a band. Of `curve` "measured" is the
#: centreline, entry first; "fitted" is there where the solve succeeded; "low", "middle" and "high" are the
#: simultaneous 95 % band in the bending plane, of certified draws.
NEEDLE_COLUMNS = (
    *("fold", "role", "insertion", "diameter_mm", "band_source"),
    *("curve", "j", "x_mm", "y_mm", "z_mm"),
)


@dataclass(frozen=True)
class FittedDraws:
    """The needles of draws in the insertions that were fitted to."""

    outside: Bools  # (B,); whether any needle of the draw is outside the model's validity
    # by insertion y and z (3, K, 2) of `BAND_CURVES`, in C, mm, at `NEEDLE_POINTS` points of the needle
    bands: Mapping[str, Floats]


def simulate_fitted_draws(
    problem: Problem, draws: Draws, jobs: int = 1, *, bands: bool = True
) -> FittedDraws:
    """Return the needles of draws (B, P) in all insertions of a problem: if wanted, with their bands.

    A solve that fails is not outside the validity: it is counted as failed. Draws that are not certified have
    no bands, nor have tip tracks.
    """
    dataset, bands = problem.dataset, bands and draws.certified is not None
    outside, found = np.zeros(len(draws.thetas), dtype=np.bool_), dict[str, Floats]()
    if not len(outside):
        return FittedDraws(outside, found)
    placed = [bands and not insertion.in_tracker_frame for insertion in problem.insertions]
    places = [
        select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s
        if is_placed
        else NOWHERE
        for insertion, is_placed in zip(problem.insertions, placed, strict=True)
    ]
    sets = [problem.values(theta) for theta in draws.thetas]
    model = PreparedModel(problem.medium, problem.insertions)
    needles = model.read_needles(sets, places, jobs)
    for insertion, s, (points, is_outside) in zip(problem.insertions, places, needles, strict=True):
        outside |= is_outside
        solved = points[np.isfinite(points).all(axis=(1, 2))]  # (B, K, 3)
        if len(s) and len(solved):
            aligned = np.array([place_points(dataset, insertion, s, needle) for needle in solved])
            across, band = np.median(aligned[..., 2], axis=0), find_bands(aligned[..., 1])
            below, above = band.ends(BAND_PROBABILITY)
            found[insertion.id] = np.array(
                [np.column_stack([y, across]) for y in (below, band.median, above)]
            )
    return FittedDraws(outside, found)


def place_needles(
    problem: Problem,
    fold: Fold,
    fit: Fit,
    draws: FittedDraws | None = None,
    predicted: Iterable[HeldOutPrediction] = (),
    *,
    fitted: bool = True,
) -> Iterator[Row]:
    """Yield rows of every insertion that a fold holds out, before, if wanted, of those `fitted` to.

    Where no needle is `predicted` it is that of the fit. Tip tracks were never in a scan: of them there is
    none.
    """
    dataset, by_id = problem.dataset, {prediction.insertion: prediction for prediction in predicted}
    for role, insertions in (("tune", fold.tune if fitted else ()), ("validate", fold.validate)):
        for insertion in (insertion for insertion in insertions if not insertion.in_tracker_frame):
            placement, band = Placement(insertion.frame, insertion.patient), list[Floats]()
            prediction = by_id.get(insertion.id) if role == "validate" else None
            curve = prediction.curve if prediction else None
            if curve is None:
                shape = predict(fit.values, problem.medium, insertion)
                curve = SimulatedCurve(shape, insertion) if shape.converged else None
            s = select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s
            points = None if curve is None else place_points(dataset, insertion, s, curve(s))
            if prediction is not None:
                band = _find_predicted_band(insertion, prediction.rows.get("bands", ()))
            elif role == "tune" and points is not None and draws is not None:
                across = draws.bands.get(insertion.id, ())
                band = [np.column_stack([points[:, 0], part]) for part in across]
            source = "posterior" if prediction is None else "predicted"
            curves = {"measured": insertion.patient.to_local(insertion.centerline)}
            curves |= {} if points is None else {"fitted": placement.to_patient(points)}
            curves |= dict(zip(BAND_CURVES, map(placement.to_patient, band), strict=False))
            diameter = insertion.needle.outer_diameter or DEFAULT_DIAMETER_MM
            about = (fold.name, role, insertion.id, diameter, source if band else "")
            for name, places in curves.items():
                for j, point in enumerate(places.tolist()):
                    yield dict(zip(NEEDLE_COLUMNS, (*about, name, j, *point), strict=True))


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


def _find_predicted_band(insertion: Insertion, rows: Sequence[Mapping[str, Any]]) -> list[Floats]:
    """Return the band of what was predicted to be measured, in C; empty without a prediction.

    Where only the shape is known, predictions stand in a frame of their own: the band keeps its distance from
    the measured needle.
    """
    if not rows:
        return []
    x, measured, *heights = np.array(
        [[row[f"{name}_mm"] for name in ("x", "measured", "low_95", "median", "high_95")] for row in rows]
    ).T
    shift = np.interp(x, *insertion.points.T[:2]) - measured
    across = np.array([row.get("median_z_mm", 0.0) for row in rows])
    return [np.column_stack([x, y + shift, across]) for y in heights]
