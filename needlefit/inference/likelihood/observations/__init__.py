"""What can be measured of an insertion, here or by a plugin, and how a simulation is read and measured alike.

An insertion states by what it was measured (`Insertion.observations`). What a file here does not override is
that of points along the needle, read at the end of the insertion.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import OBSERVATION_COLUMN, OBSERVATION_PREFIX
from needlefit.datasets.insertion import Dataset, Insertion, Noise, Pose, find_free_reach, find_pose
from needlefit.datasets.noise import NoiseFloor, estimate_noise_floor
from needlefit.errors import DataError
from needlefit.geometry.curves import COMPARISON_POINTS
from needlefit.inference.likelihood.compared_points import ComparedPoints, rotate_to_entry_axes
from needlefit.inference.likelihood.nodes import ErrorAxis, Surface
from needlefit.inference.likelihood.observation import Observation, join_observations
from needlefit.inference.likelihood.stated_errors import PLAIN_LIKELIHOOD, Discrepancy, StatedErrors
from needlefit.mechanics.batch import (
    Jacobians,
    NeedleShapes,
    compute_batch_positions,
    differentiate_batch_positions,
)
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.metrics import list_metrics
from needlefit.registry import Registry
from needlefit.schemas.base import Compared
from needlefit.schemas.recipe import LikelihoodRecord


@dataclass(frozen=True)
class ObservationType:
    """One thing that can be measured of an insertion."""

    #: what insertions state in `observation`
    name: str
    #: whether it is read while the needle is inserted: insertions alike are then simulated once
    on_the_way: bool = False
    #: whether a curve is measured: without one some metrics and baselines mean nothing
    is_curve: bool = True
    #: whether the place of the tip is measured
    has_tip: bool = True

    def take_alone(self, dataset: Dataset, insertion: Insertion) -> tuple[Dataset, Insertion]:
        """Return dataset and insertion as if this observation alone had been made of what was measured."""
        return dataset, replace(insertion, curvature=None, tip=None, observation_values={})

    def compare(self, dataset: Dataset, insertion: Insertion) -> tuple[ComparedPoints, ...]:
        """Return what a curve is compared with."""
        pose, compared = dataset.pose, dataset.compared
        return (self.select_points(pose, dataset.drop_proximal, insertion, COMPARISON_POINTS, compared),)

    def estimate_floor(self, dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
        """Return the mean errors of the measurement against itself, made again."""
        return estimate_noise_floor(dataset, insertion, rng)

    def select_points(
        self, pose: Pose, drop: float, insertion: Insertion, stations: int, compared: Compared
    ) -> ComparedPoints:
        """Return the measured points that a curve is compared with; see the function of that name."""
        along = insertion.measure_arc(compared)
        if pose == "known":
            fractions = np.linspace(0.0, 1.0, stations)
            s, at = insertion.depth * fractions, fractions * along[-1]
        else:
            to_tip = np.linspace(find_free_reach(drop, insertion), 0.0, stations)
            s, at = insertion.depth - to_tip, float(along[-1]) - to_tip
        measured = np.column_stack([np.interp(at, along, axis) for axis in insertion.points.T])
        if pose != "known":
            measured[:, :2] = rotate_to_entry_axes(measured[:, :2])
        return ComparedPoints(s, measured, find_pose(pose, insertion), compared)

    def read_points(self, shape: NeedleShape, s: Floats) -> Floats:
        """Return the simulated points (K, 3) at beam coordinates `s` (K,), mm."""
        return compute_positions(shape, s)

    def read_batch_points(self, shapes: NeedleShapes, s: Floats) -> Floats:
        """Return `read_points` (B, K, 3) of many simulations of one insertion."""
        return compute_batch_positions(shapes, s)

    def read_batch_derivatives(self, shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
        """Return the derivatives (B, K, 3, P) of `read_batch_points`."""
        return differentiate_batch_positions(shapes, jacobians, s)

    def measure(self, dataset: Dataset, insertion: Insertion, needle: "TrueNeedle") -> Insertion | None:
        """Return the insertion as this measures a simulated needle; None where that bends as none can."""
        return OBSERVATIONS["points"].measure(dataset, insertion, needle)

    def thin(self, insertion: Insertion, count: int) -> Insertion:
        """Return an insertion of which about `count` places were measured, of more."""
        step = max(1, math.ceil(len(insertion.points) / count))
        chosen = np.arange(len(insertion.points) - 1, -1, -step)[::-1]  # keeps the tip
        sd = None if insertion.sd is None else insertion.sd[chosen]
        return replace(insertion.with_points(insertion.points[chosen, :2]), sd=sd)

    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return what the likelihood compares; DataError if the errors that are stated leave it no width."""
        return OBSERVATIONS["points"].observe(insertion, errors)

    def observe_values(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return what it compares besides, where the insertion has `observation_values`, in a known pose.

        Fits are to both; what is predicted is that of `observe`.
        """
        raise DataError(
            f"the observation `{self.name}` has no numbers besides, and {insertion.id} has some",
            expected=f"no columns {OBSERVATION_PREFIX}{', '.join(insertion.observation_values)}",
            fix=f"remove the columns, or name their {OBSERVATION_COLUMN}",
        )


OBSERVATIONS = Registry(ObservationType, __name__, "observation")


def make_observation(
    dataset: Dataset,
    insertion: Insertion,
    noise: Noise | None = None,
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD,
    insertions: int = 1,
    model_error: Discrepancy | None = None,
    respond: Callable[[Insertion, Floats], Floats] | None = None,
) -> Observation:
    """Return the observation of one insertion, by all that was measured of it.

    `noise` replaces what the dataset states; the stored points are then taken as the needle's own. See
    `StatedErrors` for the others.

    Raises DataError if no noise is stated: without any, a likelihood has no width.
    """
    smoothed = noise is None and likelihood.measurement == "stored" and likelihood.noise == "correlated"
    dataset = dataset if noise is None else replace(dataset, noise=noise)
    errors = StatedErrors(
        dataset, dataset.noise.of(insertion), likelihood, insertions, model_error, smoothed, respond
    )
    if likelihood.measurement == "curvature":
        return OBSERVATIONS["curvature"].observe(insertion, errors)
    # the cross-sections are what the points were drawn through, and stand in their place alone
    first, *others = list_observations(insertion)
    found = (OBSERVATIONS["sections"] if smoothed and has_sections(dataset, insertion) else first).observe(
        insertion, errors
    )
    # a scale of the noise counts for the poses of others, too: joined observations have no curves of a pose
    plain = likelihood.model_copy(update={"noise_scale": 1.0})
    for kind in others:
        data, alone = kind.take_alone(dataset, insertion)
        errors_alone = replace(errors, dataset=data, noise=data.noise.of(alone), likelihood=plain)
        found = join_observations(found, kind.observe(alone, errors_alone))
    if not insertion.observation_values:
        return found
    if dataset.pose != "known":
        raise DataError(
            f"{insertion.id} has numbers besides its points, and its pose is not known",
            expected=f"no columns {OBSERVATION_PREFIX}{', '.join(insertion.observation_values)}",
            fix='remove the columns, or state poses (pose = "known")',
        )
    return join_observations(found, OBSERVATIONS[insertion.observation].observe_values(insertion, errors))


def has_sections(dataset: Dataset, insertion: Insertion) -> bool:
    """Return whether the cross-sections stand in the place of the points that were drawn through them."""
    is_shape = insertion.observation == "points" and dataset.pose == "known"
    return is_shape and insertion.sections is not None


def select_points(
    pose: Pose,
    drop: float,
    insertion: Insertion,
    stations: int = COMPARISON_POINTS,
    compared: Compared = "plane",
) -> ComparedPoints:
    """Return the measured points that a curve is compared with, entry side first, tip last.

    Pose known: both curves lie in C and are sampled at equal fractions of their own inserted arc length.

    Direction known (the entry is the first point of the inserted needle, which has moved with it): the same,
    after the shift across that brings the simulated points closest to the measured ones.

    Pose free (shapes known only up to a rigid motion): both are sampled at the same arc lengths from the tip,
    over [0, min(measured length, D) - `drop`]. The simulated points are then laid on the measured ones by the
    rigid motion that fits them best. Both are shown in the axes of the measured entry side: x along the
    least-squares line through the first fifth of the scored points, from which deflections are measured.
    """
    return OBSERVATIONS[insertion.observation].select_points(pose, drop, insertion, stations, compared)


def list_observations(insertion: Insertion) -> list[ObservationType]:
    """Return by what an insertion was measured, first what it states in `observation`."""
    return [OBSERVATIONS[name] for name in insertion.observations]


def measures_tip(insertion: Insertion) -> bool:
    """Return whether the place of the tip was measured of an insertion."""
    return any(kind.has_tip for kind in list_observations(insertion))


class ScoredObservation(NamedTuple):
    """An observation by which an insertion is scored; dataset and insertion as if it alone had been made."""

    kind: ObservationType
    dataset: Dataset
    insertion: Insertion


def list_scored(dataset: Dataset, insertion: Insertion) -> list[ScoredObservation]:
    """Return by what an insertion is scored: each of its observations that has all directions compared."""
    scored = [
        ScoredObservation(kind, *kind.take_alone(dataset, insertion)) for kind in list_observations(insertion)
    ]
    others = [part for part in scored[1:] if part.insertion.directions >= dataset.directions]
    return [*scored[:1], *others]


def list_comparisons(dataset: Dataset, insertion: Insertion) -> list[ComparedPoints]:
    """Return all that a curve is compared with of an insertion, by each of its observations."""
    scored = list_scored(dataset, insertion)
    return [goal for kind, data, alone in scored for goal in kind.compare(data, alone)]


def estimate_floor(dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
    """Return the mean errors of all that was measured of an insertion against itself, measured again.

    Those of places are NaN where none was measured; of a tip that was measured by itself they are its own.
    """
    floors = {metric.name: math.nan for metric in list_metrics("places") if metric.has_floor}
    for kind, data, alone in list_scored(dataset, insertion):
        estimated = kind.estimate_floor(data, alone, rng)
        floors |= {name: floor for name, floor in estimated.items() if not math.isnan(floor)}
    return floors


def read_points(insertion: Insertion, shape: NeedleShape, s: Floats) -> Floats:
    """Return the simulated points (K, 3) of an insertion, mm; NaN where the solve failed.

    `s` (K,), mm, are those of its observation: beam coordinates, or depths.
    """
    if not shape.converged:
        return np.full((len(s), 3), np.nan)
    return OBSERVATIONS[insertion.observation].read_points(shape, s)


@dataclass(frozen=True)
class TrueNeedle:
    """A simulated needle that is measured, with errors `scale` times as large as stated."""

    insertion: Insertion  #: as it truly was
    shape: NeedleShape
    deeper: float = 0.0  #: than stated, mm
    scale: float = 1.0
    rng: np.random.Generator | None = None  #: draws the errors; None: there are none
    errors: StatedErrors | None = None  #: of readings on the way; None: those that the dataset states
    #: errors, in standard deviations, that several insertions share; filled as needed
    shared: dict[Surface, float] = field(default_factory=dict)

    def read(self, s: Floats) -> Floats:
        """Return its points (K, 3) at stated beam coordinates `s` (K,), mm."""
        return read_points(self.insertion, self.shape, s + self.deeper)

    def draw(self, *shape: int) -> Floats:
        """Return errors in standard deviations."""
        return np.zeros(shape) if self.rng is None else self.rng.standard_normal(shape)

    def draw_errors(self, covariance: Floats) -> Floats:
        """Return errors (K,) with a covariance (K, K)."""
        draws = self.draw(len(covariance))
        return draws if self.rng is None else np.linalg.cholesky(covariance) @ draws

    def draw_along(self, axes: Sequence[ErrorAxis]) -> Floats:
        """Return errors (d,) in standard deviations along axes; what insertions share is drawn once."""
        errors = self.draw(len(axes))
        for n, axis in enumerate(axes):
            if axis.surface and axis.surface not in self.shared:
                self.shared[axis.surface] = float(self.draw(1)[0])
            errors[n] = axis.own * errors[n] + axis.shared * self.shared.get(axis.surface, 0.0)
        return errors


def measure(dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion | None:
    """Return an insertion as all that it holds measures a simulated needle; None where nothing can."""
    measured: Insertion | None = insertion
    for kind in list_observations(insertion) if needle.shape.converged else ():
        measured = None if measured is None else kind.measure(dataset, measured, needle)
    return measured if needle.shape.converged else None


@dataclass(frozen=True)
class SimulatedCurve:
    """A simulated insertion as a function: see `read_points`."""

    shape: NeedleShape
    insertion: Insertion

    def __call__(self, s: Floats) -> Floats:
        """Return the points at `s` (K,)."""
        return read_points(self.insertion, self.shape, s)
