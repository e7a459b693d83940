"""Place measured and fitted needles in the scan's coordinates, with 95 % bands.

The band of a held-out needle is where it was predicted to be measured; without a prediction there is none.
That of a needle that was fitted to says how it would move with the parameters, as far as the data know them:
neither the noise of the measured points nor what the model misses is in it. From a posterior it is the
central 95 % of the needles of its draws. Without one it is linear about the fit: 1.96 standard deviations,
over every direction that `identify` found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, TipTrack
from needlefit.errors import ModelError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import Placement, align_rigid
from needlefit.grouping import group_values
from needlefit.inference.compared_points import SimulatedCurve, select_points
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import make_batch, predict
from needlefit.inference.identifiability.identify import Identifiability
from needlefit.inference.identifiability.precision import difference_jacobian, difference_steps
from needlefit.inference.predict import thin_posterior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.studies.job import Fold
from needlefit.studies.needles_in_scan import Band, NeedleInScan

NEEDLE_POINTS = 51  # points of a fitted needle and of its band
BAND_DRAWS = 400  # most draws of a posterior of which needles are simulated for a band
BAND_PERCENTILES = (2.5, 50.0, 97.5)
# Half width of the central 95 % of a normal distribution, in standard deviations.
NORMAL_95_HALF_WIDTH_SD = 1.959963984540054


@dataclass(frozen=True)
class FoldFit:
    """The results of one fold: the fit, its identifiability, and draws where they were requested."""

    fit: Fit
    verdict: Identifiability
    posterior: Posterior | None = None


def place_needles(
    problem: Problem,
    fold: Fold,
    known: FoldFit,
    predicted: Sequence[Mapping[str, Any]] = (),
    jobs: int = 1,
    *,
    fitted: bool = True,
) -> dict[str, NeedleInScan]:
    """Return every insertion that a fold holds out, and, if wanted, those that its problem is `fitted` to.

    `predicted` are the rows of the table "bands". Tip tracks were never in a scan: of them there is none.
    """
    bands = group_values((row["insertion"], row) for row in predicted if row["fold"] == fold.name)
    chosen = [*([("tune", fold.tune)] if fitted else []), ("validate", fold.validate)]
    return {
        insertion.id: _place_needle(
            _NeedleCurve(problem, insertion), (fold.name, role), known, bands.get(insertion.id, ()), jobs
        )
        for role, insertions in chosen
        for insertion in insertions
        if not isinstance(insertion, TipTrack)
    }


def _place_needle(
    stations: "_NeedleCurve",
    place: tuple[str, str],
    known: FoldFit,
    predicted: Sequence[Mapping[str, Any]],
    jobs: int,
) -> NeedleInScan:
    """Return an insertion that has this place, a fold and a role in it."""
    insertion, stated = stations.insertion, stations.problem.dataset.outer_diameter
    placement = Placement(insertion.frame, insertion.patient)
    points = stations.points(np.array(known.fit.theta))
    fitted = points if np.isfinite(points).all() else None
    band = None
    if place[1] == "validate":
        band = _place_predicted_band(insertion, placement, predicted)
    elif fitted is not None:
        draws = known.posterior
        heights = _sampled_band(stations, draws, jobs) if draws else _linear_band(stations, known)
        if heights is not None:  # else no needle beside the fitted one can be solved
            low, middle, high = (placement.to_patient(np.column_stack([fitted[:, 0], y])) for y in heights)
            converged = draws is None or not draws.faults
            band = Band(low, middle, high, "posterior" if draws else "linear", converged)
    return NeedleInScan(
        insertion=insertion.id,
        fold=place[0],
        role=place[1],
        measured=insertion.patient.to_local(insertion.centerline),
        toward=placement.across,
        diameter=DEFAULT_DIAMETER_MM if stated is None else stated,
        fitted=None if fitted is None else placement.to_patient(fitted),
        band=band,
    )


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


@dataclass(frozen=True)
class _NeedleCurve:
    """The places on one needle at which it is drawn."""

    problem: Problem
    insertion: Insertion

    @property
    def s(self) -> Floats:
        """Beam coordinates (K,), mm."""
        dataset = self.problem.dataset
        return select_points(dataset.pose, dataset.drop_proximal, self.insertion, NEEDLE_POINTS).s

    def points(self, theta: Floats) -> Floats:
        """Return the needle (K, 2) in C, aligned where the pose is free; NaN where the solve fails."""
        values = self.problem.parameters.values(theta)
        shape = predict(values, self.problem.medium, self.problem.dataset.needle, self.insertion)
        if not shape.converged:
            return np.full((NEEDLE_POINTS, 2), np.nan)
        return self.align(SimulatedCurve(shape)(self.s))

    def heights(self, theta: Floats) -> Floats:
        """Return y of the needle (K,)."""
        return self.points(theta)[:, 1]

    def align(self, points: Floats) -> Floats:
        """Return a simulated needle (K, 2) as it lies in C: a free shape lies on the measured one."""
        return (
            points
            if self.problem.dataset.pose == "known"
            else align_with_measured(self.insertion, self.s, points)
        )


def align_with_measured(insertion: Insertion, s: Floats, points: Floats) -> Floats:
    """Return points (K, 2) of a simulated needle at `s` (K,), mm, aligned with the measured one."""
    planar = insertion.planar
    measured = interpolate_at_arc(planar, arc_length(planar)[-1] - (insertion.depth - s))
    return align_rigid(points, measured)


def _linear_band(stations: _NeedleCurve, known: FoldFit) -> tuple[Floats, Floats, Floats] | None:
    """Return the band (low, middle, high) of y, linear about the fit; None where it cannot be found."""
    names, theta = stations.problem.parameters.free, np.array(known.fit.theta)
    fitted = stations.heights(theta)
    if not names:
        return None
    weights = np.array([direction.weights for direction in known.verdict.directions])  # (D, P)
    sds = np.array([direction.sd for direction in known.verdict.directions])

    def heights(at: Floats) -> Floats:
        try:
            return stations.heights(at)
        except ModelError:  # a step leads out of the bounds of a shape parameter
            return np.full_like(fitted, np.nan)

    moves = difference_jacobian(heights, theta, difference_steps(names)) @ weights.T * sds  # (K, D)
    width = NORMAL_95_HALF_WIDTH_SD * np.sqrt(np.sum(moves**2, axis=1))
    if not np.isfinite(width).all():
        return None
    return fitted - width, fitted, fitted + width


def _sampled_band(
    stations: _NeedleCurve, posterior: Posterior, jobs: int
) -> tuple[Floats, Floats, Floats] | None:
    """Return the band (low, middle, high) of y over the needles of draws; None where none can be solved."""
    problem, insertion = stations.problem, stations.insertion
    draws = thin_posterior(posterior, problem.parameters, BAND_DRAWS)
    sets = [problem.parameters.values(theta) for theta in draws.thetas]
    (shapes,) = simulate_batches([make_batch(sets, problem.medium, problem.dataset.needle, insertion)], jobs)
    needles = compute_batch_positions(shapes, stations.s)[shapes.converged]  # (B, K, 2)
    if not len(needles):
        return None
    heights = np.array([stations.align(needle)[:, 1] for needle in needles])  # (B, K)
    low, middle, high = np.percentile(heights, BAND_PERCENTILES, axis=0)
    return low, middle, high
