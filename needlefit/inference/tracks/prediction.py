"""Predict the later readings of a run from its first ones, by draws of a model or by baseline curves.

Given the deflections y of one draw of the parameters, the readings of a run are Gaussian,

    t = y + F n + noise,        n = (shift, slope),   shift free,   slope ~ N(m, v)

with m and v from the runs fitted to: m the mean of the slopes that y leaves in them, v what their scatter s^2
says of one more run, s^2 (1 + 1/k) (k - 1) / (k - 3), the variance of Student's t for k runs. Conditioned on
the first readings this is Gaussian again. What the run does further on enters nowhere.

Baselines: curves without tissue or guide, fitted to the same runs.

A straight line leaves nothing to fit but each run's shift and slope. A parabola has one curvature for all
runs, toward the bevel. The scale of the noise is what they leave of the runs fitted to, so that what they
predict is as wide as their residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import ConfigError
from needlefit.inference.tracks.problem import TrackObservation

Floats = NDArray[np.float64]

SHIFT_SD_MM = 100.0
"""Prior deviation of a shift, mm: no reading lies as far from another."""

MIN_TUNED_RUNS = 4
"""Runs from whose scatter the slope of a further one is estimated."""


@dataclass(frozen=True)
class TrackDraws:
    """B draws of a model: the deflections of some runs, and the scale of the noise.

    Attributes
    ----------
    tuned, held_out : tuples of (B, n) arrays
        Deflections at the readings of the runs fitted to, and of those predicted, mm.
    scale : (B,) array
        What the stated deviations of the noise are multiplied by.
    """

    tuned: tuple[Floats, ...]
    held_out: tuple[Floats, ...]
    scale: Floats


@dataclass(frozen=True)
class SlopeMoments:
    """Mean and variance (B,) of the slope of a further run in the tracker's frame."""

    mean: Floats
    variance: Floats


def estimate_slopes(drawn: TrackDraws, tuned: Sequence[TrackObservation]) -> SlopeMoments:
    """Estimate the slope of another run from the runs fitted to, for every draw.

    Raises
    ------
    ConfigError
        If there are too few runs to take a scatter from.
    """
    k = len(tuned)
    if k < MIN_TUNED_RUNS:
        raise ConfigError(
            f"{k} runs say too little of the slope of another one",
            expected=f"at least {MIN_TUNED_RUNS} runs to fit to",
            fix="tune on more runs",
        )
    pairs = zip(tuned, drawn.tuned, strict=True)
    each = np.array(
        [(observation.track.tip - y) @ observation.estimator[1] for observation, y in pairs]
    )  # (k, B)
    inflated = (1 + 1 / k) * (k - 1) / (k - 3)
    return SlopeMoments(each.mean(axis=0), inflated * each.var(axis=0, ddof=1))


def predict_readings(
    observation: TrackObservation,
    deflection: Floats,
    scale: Floats,
    slope: SlopeMoments,
    observed_count: int,
    rng: np.random.Generator,
) -> Floats:
    """Return draws (B, n - observed_count) of the readings of a run after the first `observed_count`, mm.

    Parameters
    ----------
    deflection : (B, n) array
        Of the run's tip, one row a draw.
    """
    design = observation.frame  # (n, 2)
    spread = np.zeros((len(scale), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = SHIFT_SD_MM**2, slope.variance
    noise = observation.covariance * scale[:, None, None] ** 2
    total = noise + design @ spread @ design.T  # (B, n, n)
    mean = deflection + slope.mean[:, None] * design[:, 1]
    # conditioning of a joint Gaussian: gain^T takes the residuals of the first readings to the later ones
    gain = np.linalg.solve(
        total[:, :observed_count, :observed_count], total[:, :observed_count, observed_count:]
    )  # (B, k, n - k)
    off = observation.track.tip[:observed_count] - mean[:, :observed_count]
    centre = mean[:, observed_count:] + np.einsum("bk,bkr->br", off, gain)
    remaining = (
        total[:, observed_count:, observed_count:]
        - gain.transpose(0, 2, 1) @ total[:, :observed_count, observed_count:]
    )
    root = np.linalg.cholesky(remaining)
    drawn: Floats = centre + np.einsum("brs,bs->br", root, rng.normal(size=centre.shape))
    return drawn


TRACK_CURVES = ("straight", "constant_curvature")


def fit_curve(
    name: str,
    tuned: Sequence[TrackObservation],
    held_out: Sequence[TipTrack],
    count: int,
    rng: np.random.Generator,
) -> TrackDraws:
    """Return `count` draws of the baseline `name` given the runs `tuned`: Student's t about least squares."""
    basis = np.concatenate(
        [observation.whitening @ _unit_deflection(observation.track) for observation in tuned]
    )
    measured = np.concatenate([observation.whitening @ observation.track.tip for observation in tuned])
    fitted = name == "constant_curvature"
    best = float(basis @ measured / (basis @ basis)) if fitted else 0.0
    squares, free = float(np.sum((measured - best * basis) ** 2)), len(measured) - fitted
    # the order of the draws matters for the result: scale first, then curvature
    scale = np.sqrt(squares / rng.chisquare(free, size=count))
    curvature = best + fitted * scale / np.linalg.norm(basis) * rng.normal(size=count)
    return TrackDraws(
        tuple(np.outer(curvature, _unit_deflection(observation.track)) for observation in tuned),
        tuple(np.outer(curvature, _unit_deflection(track)) for track in held_out),
        scale,
    )


def _unit_deflection(track: TipTrack) -> Floats:
    """Return what a unit curvature toward the bevel does to the readings (n,), mm^2."""
    bow: Floats = track.side * track.depth**2 / 2
    return bow
