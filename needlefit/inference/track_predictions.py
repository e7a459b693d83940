"""Predict the later readings of a run of tip tracks from its first ones, by the model and by baselines.

Given the deflections y of one draw of the parameters, the readings of a run are Gaussian. Those of the model
have the errors of the likelihood, of which the fitted runs determine what all runs share, z:

    t = y + shift + sum_j x_j (own_j e_j + shared_j . z) + noise,      e, z ~ N(0, 1),   shift free

with columns x_j by slope and by the response to the guide. Conditioned on the first readings of a run this is
Gaussian again; what the run does further on enters nowhere.

Baselines are curves without tissue or guide, fitted to the same runs: a straight line has nothing but each
run's shift and slope, a parabola one curvature for all runs. The slope of a further run has the mean of those
of k fitted runs and the variance s^2 (1 + 1/k) f / (f - 2) of Student's t; s^2 is their scatter, of f degrees
of freedom, k - 1 where all runs are taken. The scale of the noise is what they leave of the runs fitted to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, TipTrack
from needlefit.errors import ConfigError
from needlefit.inference.baselines import BASELINES, Baseline
from needlefit.inference.likelihood.nodes import NodeGroup
from needlefit.inference.likelihood.observation import Observation, whiten

SHIFT_SD_MM = 100.0  #: prior deviation of a shift, mm: no reading lies as far from another
MIN_TUNED_RUNS = 4  #: runs from whose scatter the slope of a further one is estimated


@dataclass(frozen=True)
class TrackDraws:
    """B draws of a model: the deflections of some runs, and the scale of the noise."""

    #: tuned, held_out: (B, n) each deflections at the readings of the runs fitted to, and of those predicted,
    #: mm
    tuned: tuple[Floats, ...]
    held_out: tuple[Floats, ...]
    scale: Floats  #: (B,) what the stated deviations of the noise are multiplied by
    #: whether the slope of a run is estimated from those alone whose guide moved, or rested, as in it
    alike: bool = False
    #: of the same runs: (B, d, n) each the changes by one SD along the d axes of their errors
    tuned_columns: tuple[Floats, ...] = ()
    held_out_columns: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class SlopeMoments:
    """Mean and variance (B,) of the slope of a further run in the tracker's frame."""

    mean: Floats
    variance: Floats


def estimate_slopes(
    drawn: TrackDraws, tuned: Sequence[Observation], further: Insertion | None = None
) -> SlopeMoments:
    """Estimate the slope of another run from the runs fitted to, for every draw.

    Where runs alike tell it, their scatter is taken from both kinds, each about its own mean.

    Raises ConfigError if there are too few runs to take a scatter from.
    """
    k = len(tuned)
    if k < MIN_TUNED_RUNS:
        raise ConfigError(
            f"{k} runs say too little of the slope of another one",
            expected=f"at least {MIN_TUNED_RUNS} runs to fit to",
            fix="tune on more runs",
        )
    pairs = zip(tuned, drawn.tuned, strict=True)
    each = np.array([(one.measured[:, 1] - y) @ one.estimator[1] for one, y in pairs])  # (k, B)
    kinds = np.array([_is_guided(one.insertion) for one in tuned])
    apart = drawn.alike and k > MIN_TUNED_RUNS and np.any(kinds == _is_guided(further))
    kinds, like = (kinds, kinds == _is_guided(further)) if apart else (np.full(k, False), np.full(k, True))
    squares = sum(len(one) * one.var(axis=0) for one in (each[kinds], each[~kinds]) if len(one))
    freedom = k - len(set(kinds.tolist()))
    variance = squares / freedom * (1 + 1 / like.sum()) * freedom / (freedom - 2)
    return SlopeMoments(each[like].mean(axis=0), variance)


def _is_guided(insertion: Insertion | None) -> bool:
    return isinstance(insertion, TipTrack) and insertion.guided


def predict_readings(
    observation: Observation,
    deflection: Floats,
    scale: Floats,
    slope: SlopeMoments,
    observed_count: int,
    rng: np.random.Generator,
) -> Floats:
    """Return draws (B, n - observed_count) of the readings of a run after the first `observed_count`, mm.

    `deflection` (B, n) is the tip's, one row a draw.
    """
    design = observation.free  # (n, 2)
    spread = np.zeros((len(scale), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = SHIFT_SD_MM**2, slope.variance
    noise = observation.point_covariance * scale[:, None, None] ** 2
    total = noise + design @ spread @ design.T  # (B, n, n)
    mean = deflection + slope.mean[:, None] * design[:, 1]
    return _draw_later_readings(observation.measured[:, 1], mean, total, observed_count, rng)


def _draw_later_readings(
    measured: Floats, mean: Floats, total: Floats, observed_count: int, rng: np.random.Generator
) -> Floats:
    """Draw the later readings of a Gaussian, mean (B, n) and covariance (B, n, n), given the first ones."""
    # conditioning of a joint Gaussian: gain^T takes the residuals of the first readings to the later ones
    cross = total[:, :observed_count, observed_count:]
    gain = np.linalg.solve(total[:, :observed_count, :observed_count], cross)  # (B, k, n - k)
    off = measured[:observed_count] - mean[:, :observed_count]
    centre = mean[:, observed_count:] + np.einsum("bk,bkr->br", off, gain)
    remaining = total[:, observed_count:, observed_count:] - gain.transpose(0, 2, 1) @ cross
    root = np.linalg.cholesky(remaining)
    return centre + np.einsum("brs,bs->br", root, rng.normal(size=centre.shape))


def predict_runs(
    drawn: TrackDraws,
    tuned: Sequence[Observation],
    held_out: Sequence[Observation],
    observed: Sequence[int],
    rng: np.random.Generator,
) -> list[Floats]:
    """Return of each run held out draws (B, n - k) of its readings after the first k, `observed`, mm.

    What runs share is estimated from the runs fitted to, for every draw, and from the first readings.
    """
    every = (*tuned, *held_out)
    surfaces = sorted({axis.surface for one in every for axis in one.nodes.axes if axis.surface})
    group, count = NodeGroup(tuple(one.nodes for one in every), tuple(surfaces)), len(tuned)

    def spread(k: int, columns: Floats) -> tuple[Floats, Floats]:
        """Return the covariance (B, n, n) of a run's own errors, and the columns (B, n, K) of the shared."""
        own = group.own[k][:, None] * columns
        noise = drawn.scale[:, None, None] ** 2 * every[k].point_covariance + SHIFT_SD_MM**2
        return noise + own.transpose(0, 2, 1) @ own, columns.transpose(0, 2, 1) @ group.shared[k]

    pull = np.zeros((len(drawn.scale), len(surfaces)))
    precision = np.tile(np.eye(len(surfaces)), (len(pull), 1, 1))
    for k, (one, y) in enumerate(zip(tuned, drawn.tuned, strict=True)):
        covariance, shared = spread(k, drawn.tuned_columns[k])
        weighted = np.linalg.solve(covariance, shared).transpose(0, 2, 1)  # (B, K, n)
        precision = precision + weighted @ shared
        pull = pull + np.einsum("bkn,bn->bk", weighted, one.measured[:, 1] - y)
    found = np.linalg.inv(precision)
    best = np.einsum("bkl,bl->bk", found, pull)
    predicted = []
    for k, (one, y) in enumerate(zip(held_out, drawn.held_out, strict=True)):
        covariance, shared = spread(count + k, drawn.held_out_columns[k])
        mean = y + np.einsum("bnk,bk->bn", shared, best)
        total = covariance + shared @ found @ shared.transpose(0, 2, 1)
        predicted.append(_draw_later_readings(one.measured[:, 1], mean, total, observed[k], rng))
    return predicted


def list_columns(observation: Observation, curves: Floats) -> Floats:
    """Return the changes (B, d, n) of a run by one SD along its d axes, of curves (B, m, n) at its nodes."""
    frame = np.broadcast_to(observation.pose_spread.T, (len(curves), *observation.pose_spread.T.shape))
    return np.asarray(observation.nodes.linear[1:] @ np.concatenate([curves, frame], axis=1))


def draw_baseline(
    baseline: Baseline,
    tuned: Sequence[Observation],
    held_out: Sequence[Insertion],
    count: int,
    rng: np.random.Generator,
) -> TrackDraws:
    """Return `count` draws of a baseline given the runs `tuned`: Student's t about least squares.

    Raises ValueError if the baseline has no `track_basis`.
    """
    if baseline.track_basis is None:
        raise ValueError(f"the baseline {baseline.name} predicts no tip tracks")
    with BASELINES.plugin_error_context(baseline.name):
        known = [_find_basis(baseline, one.insertion) for one in tuned]  # each (n, P)
        further = [_find_basis(baseline, track) for track in held_out]
    session = baseline.track_slope == "session"
    white = [whiten(one.covariance(), one.free[:, :1])[0] if session else one.whitening for one in tuned]
    basis = np.concatenate([one @ columns for one, columns in zip(white, known, strict=True)])
    used = np.linalg.norm(basis, axis=0) > 0  # without a moved guide its effects are not known: taken as none
    basis, known, further = basis[:, used], [one[:, used] for one in known], [one[:, used] for one in further]
    measured = np.concatenate([one @ seen.measured[:, 1] for one, seen in zip(white, tuned, strict=True)])
    unknowns = basis.shape[1]
    best = np.linalg.solve(basis.T @ basis, basis.T @ measured)
    squares = float(np.sum((measured - basis @ best) ** 2))
    # the order of the draws matters for the result: scale first, then coefficients. A straight line, which
    # has none, draws and drops one of them.
    scale = np.sqrt(squares / rng.chisquare(len(measured) - unknowns, size=count))
    normal = rng.normal(size=(max(1, unknowns), count))[:unknowns]
    root = np.linalg.cholesky(np.linalg.inv(basis.T @ basis))
    coefficients = best + (scale * (root @ normal)).T  # (B, P)
    return TrackDraws(
        tuple(coefficients @ columns.T for columns in known),
        tuple(coefficients @ columns.T for columns in further),
        scale,
        baseline.track_slope == "alike",
    )


def _find_basis(baseline: Baseline, track: Insertion) -> Floats:
    """Return the deflections (n, P) by unit coefficients; where runs share a slope, it is the last one."""
    assert baseline.track_basis is not None
    columns = baseline.track_basis(track)
    return np.column_stack([columns, track.planar[:, 0]]) if baseline.track_slope == "session" else columns
