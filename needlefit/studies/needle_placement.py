"""Measured and fitted needles in the scan's coordinates, with 95 % bands: as records and as a table.

The band of a held-out needle is where it was predicted to be measured; without a prediction there is none.
That of a needle that was fitted to is the central 95 % of the needles of certified draws of the posterior:
neither the noise of the measured points nor what the model misses is in it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, TipTrack
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import Placement, align_rigid
from needlefit.grouping import group_values
from needlefit.inference.compared_points import SimulatedCurve, select_points
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import make_batch, predict
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.job import Fold

NEEDLE_POINTS = 51  # points of a fitted needle and of its band
BAND_PERCENTILES = (2.5, 50.0, 97.5)


@dataclass(frozen=True)
class Band:
    """The central 95 % band across a needle, in its bending plane; (K, 3) each, LPS, mm."""

    low: Floats
    middle: Floats
    high: Floats
    source: Literal["predicted", "posterior"]  #: of a held-out needle what was predicted to be measured


@dataclass(frozen=True)
class NeedleInScan:
    """One insertion in the patient coordinates of its scan, LPS, mm."""

    insertion: str
    fold: str
    role: str  # "validate" where the fit never saw it, else "tune"
    measured: Floats  # (N, 3); the centreline, entry first
    toward: Floats  # (3,); unit vector across the entry, in the bending plane
    diameter: float  # of the needle as it is drawn
    fitted: Floats | None = None  # (K, 3); in the bending plane; None where the solve failed
    band: Band | None = None  # None where no draws are certified, or none of them has a solution


def place_needles(
    problem: Problem,
    fold: Fold,
    fit: Fit,
    draws: Draws | None = None,
    predicted: Sequence[Mapping[str, Any]] = (),
    jobs: int = 1,
    *,
    fitted: bool = True,
) -> Iterator[NeedleInScan]:
    """Yield every insertion that a fold holds out, before them, if wanted, those that were `fitted` to.

    `predicted` are the rows of the table "bands". Tip tracks were never in a scan: of them there is none.
    """
    bands = group_values((row["insertion"], row) for row in predicted if row["fold"] == fold.name)
    dataset = problem.dataset
    for role, insertions in (("tune", fold.tune if fitted else ()), ("validate", fold.validate)):
        for insertion in insertions:
            if isinstance(insertion, TipTrack):
                continue
            placement, band = Placement(insertion.frame, insertion.patient), None
            points = _simulate_needle(problem, insertion, np.array(fit.theta))
            if role == "validate":
                band = _place_predicted_band(insertion, placement, bands.get(insertion.id, ()))
            elif points is not None and draws is not None and draws.certified is not None:
                band = _place_band_of_draws(problem, insertion, placement, points[:, 0], draws.thetas, jobs)
            yield NeedleInScan(
                insertion.id,
                fold.name,
                role,
                measured=insertion.patient.to_local(insertion.centerline),
                toward=placement.across,
                diameter=dataset.outer_diameter or DEFAULT_DIAMETER_MM,
                fitted=None if points is None else placement.to_patient(points),
                band=band,
            )


def _simulate_needle(problem: Problem, insertion: Insertion, theta: Floats) -> Floats | None:
    """Return the needle (K, 2) in C, on the measured one where the pose is free; None without a solution."""
    values = problem.parameters.values(theta)
    shape = predict(values, problem.medium, problem.dataset.needle, insertion)
    if not shape.converged:
        return None
    s = _choose_places(problem, insertion)
    return _align(problem, insertion, s, SimulatedCurve(shape)(s))


def _choose_places(problem: Problem, insertion: Insertion) -> Floats:
    """Return the beam coordinates (K,), mm, at which a needle is drawn."""
    dataset = problem.dataset
    return select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s


def _align(problem: Problem, insertion: Insertion, s: Floats, points: Floats) -> Floats:
    """Return a simulated needle (K, 2) as it lies in C."""
    return points if problem.dataset.pose == "known" else align_with_measured(insertion, s, points)


def align_with_measured(insertion: Insertion, s: Floats, points: Floats) -> Floats:
    """Return points (K, 2) of a simulated needle at `s` (K,), mm, aligned with the measured one."""
    planar = insertion.planar
    measured = interpolate_at_arc(planar, arc_length(planar)[-1] - (insertion.depth - s))
    return align_rigid(points, measured)


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
    shift = np.interp(x, *insertion.planar.T) - measured
    low, middle, high = (placement.to_patient(np.column_stack([x, y + shift])) for y in heights)
    return Band(low, middle, high, "predicted")


def _place_band_of_draws(
    problem: Problem, insertion: Insertion, placement: Placement, x: Floats, thetas: Floats, jobs: int
) -> Band | None:
    """Return the band over the needles of draws, at the fitted needle's x (K,); None where none is solved."""
    sets = [problem.parameters.values(theta) for theta in thetas]
    (shapes,) = simulate_batches([make_batch(sets, problem.medium, problem.dataset.needle, insertion)], jobs)
    s = _choose_places(problem, insertion)
    needles = compute_batch_positions(shapes, s)[shapes.converged]  # (B, K, 2)
    if not len(needles):
        return None
    heights = [_align(problem, insertion, s, needle)[:, 1] for needle in needles]
    low, middle, high = (
        placement.to_patient(np.column_stack([x, y]))
        for y in np.percentile(heights, BAND_PERCENTILES, axis=0)
    )
    return Band(low, middle, high, "posterior")


def tabulate_needles(needles: Iterable[NeedleInScan]) -> pd.DataFrame:
    """Return needles point by point: columns `fit_frames.COLUMNS["needles"]`."""
    rows = []
    for one in needles:
        band = one.band
        about = (one.fold, one.role, one.insertion, one.diameter, band.source if band else "")
        curves = {"measured": one.measured, "toward": one.toward[None]}
        curves |= {} if one.fitted is None else {"fitted": one.fitted}
        curves |= {} if band is None else {"low": band.low, "middle": band.middle, "high": band.high}
        rows += [
            (*about, curve, j, *point)
            for curve, points in curves.items()
            for j, point in enumerate(points.tolist())
        ]
    return pd.DataFrame(rows, columns=list(COLUMNS["needles"]))


def read_needles(frame: pd.DataFrame) -> dict[str, NeedleInScan]:
    """Return the needles that `tabulate_needles` tabulated, by insertion."""
    found = {}
    for name, rows in frame.groupby("insertion", sort=False):
        curves = {
            str(curve): points[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=np.float64)
            for curve, points in rows.groupby("curve", sort=False)
        }
        first, band = rows.iloc[0], None
        if "middle" in curves:
            band = Band(curves["low"], curves["middle"], curves["high"], first["band_source"])
        found[str(name)] = NeedleInScan(
            str(name),
            str(first["fold"]),
            str(first["role"]),
            measured=curves["measured"],
            toward=curves["toward"][0],
            diameter=float(first["diameter_mm"]),
            fitted=curves.get("fitted"),
            band=band,
        )
    return found
