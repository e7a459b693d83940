"""Steer a needle with feedback: the commanded inputs, the measurements, and the path that is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.draws import draw_from_prior
from needlefit.inference.forward_model import ParameterDraws, make_options, select_layer_draws
from needlefit.inference.likelihood.observations.curvature import SECOND_DIFFERENCE, SENSOR_STEP_MM, surround
from needlefit.inference.parameters import Parameters, make_tissue
from needlefit.mechanics.batch import (
    Batch,
    NeedleShapes,
    compute_batch_positions,
    differentiate_batch_positions,
    linearize_batches,
    simulate_batches,
)
from needlefit.mechanics.control import Step
from needlefit.mechanics.session import Session
from needlefit.planning.draw_weights import SteeredDraws
from needlefit.planning.goals import Goal
from needlefit.planning.steered_needle import make_steered_scene
from needlefit.planning.steering import (
    SEARCH_DRAWS,
    PlanLimits,
    StartedInsertion,
    SteeringPlan,
    plan_steering,
)
from needlefit.project.toml import read_given
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import TrackErrorsRecord
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.schemas.scene import ObstacleRecord, SceneRecord
from needlefit.studies.run import FIT_KINDS, Run, draw_insertion

#: SD of the gain of the base's moves where no fit states one: 14 measured runs followed 28 % less
GAIN_SD = 0.25
#: largest distance (mm) of a measured tip before the needle's; one farther away is another needle's
TIP_MARGIN_MM = 5.0
DEPTH_STEP_MM = 1e-3  #: step in depth (mm) of the difference quotient by depth
Kind = Literal["tip", "shape", "curvatures"]
Given = str | Path | Mapping[str, Any]  #: a name, a path, or a table of keys


@dataclass(frozen=True)
class Learned:
    """What a measurement did to the draws."""

    effective: float  #: effective number of draws
    rounds: int  #: in how many rounds new draws were made, as too few of those before remained
    #: (K, D) measured minus expected before, in standard deviations of both together; beyond 3 the model, or
    #: the stated SD, is in doubt
    surprise: Floats


@dataclass(frozen=True)
class TipPrediction:
    """Where the tip is expected: mean and central 95 % interval, mm, (D,): y, in space y and z."""

    depth: float  #: inserted length, mm
    mean: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True)
class _Reading:
    """Values (K, D) measured of a needle, their SD, and the path that led to it."""

    kind: Kind
    path: tuple[Step, ...]
    places: Floats  #: (K,) x of points, mm; of curvatures beam coordinates, mm
    values: Floats
    sd: float

    def expect(self, shapes: NeedleShapes, draws: ParameterDraws) -> Floats:
        """Return what each draw expects, (B, K, D)."""
        count, directions = self.values.shape
        compared = slice(1, 1 + directions)
        if self.kind == "curvatures":
            points = compute_batch_positions(shapes, surround(self.places))[..., compared]
            return 1e3 * np.einsum(
                "t,bktd->bkd", SECOND_DIFFERENCE[0], points.reshape(-1, count, 3, directions)
            )
        if self.kind == "tip":
            return draws.find_points(shapes, self.places, self.path)[..., compared]
        near = draws.find_points(shapes, np.append(self.places - 1.0, self.places), self.path)
        before, here = near[:, :count], near[:, count:]
        part = (self.places - before[..., 0]) / (here[..., 0] - before[..., 0])  # the needle lags in x
        return (before + part[..., None] * (here - before))[..., compared]


class Steering:
    """A needle on its way: draws of its parameters, weighted by what is measured, and its path so far.

    Everything is in the constraint frame C, mm: x along the axis of insertion, y in the plane of the bevel.

    Parameters
    ----------
    source : Run, or name, path, record or table of a tissue model
        What is known before the insertion: draws of a fit, in a specimen that was not fitted where specimens
        differ; or the priors of a tissue model. New draws on the way take the Gaussian of the first ones in
        ln mu and ln b for the prior.
    scene : str, Path, SceneRecord or table
        Needle, layers and first inputs of the insertion; moduli and bevel are those of the draws.
    draws : int
        How many; 100 ms are enough to measure and to plan with 500.
    gain_sd : float, optional
        SD of the gain of the base about 1: which part of a commanded move arrives at the needle. By default
        that of the moves of a guide in the run's fit, else 0.25. Of the fit is also the SD of the share of
        the base's displacement that the tissue follows, about 0.
    slope_sd : float
        SD of dy/dx of this insertion's axis in the frame of the measurements.
    seed : int
        Of the random numbers.

    Raises ConfigError if the run has no certified draws, or no draws for as many layers.
    """

    def __init__(
        self,
        source: Run | Given | MediumRecord,
        scene: Given | SceneRecord,
        *,
        draws: int = 500,
        gain_sd: float | None = None,
        slope_sd: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._rng = np.random.default_rng(seed)
        record, name = read_given("scene", scene, SceneRecord)
        planned = make_steered_scene(record, f"scene {name}")
        if not isinstance(source, Run):
            source, _ = read_given("medium", source, MediumRecord)
        medium, table, errors = _draw_table(source, draws, self._rng)
        count = planned.tissue.layers
        if count > medium.layers:
            raise ConfigError(
                f"the scene has {count} layers, the tissue model {medium.layers}", expected="at most as many"
            )
        layers = range(1, count + 1)
        values = {str(name): float(middle) for name, middle in table.median().items()}
        tissue = make_tissue(values, layers, planned.tissue.boundaries, medium)
        layer_draws = select_layer_draws(table, layers, medium.law)
        if errors.carried_sd:
            carried = errors.carried_sd * self._rng.standard_normal(len(table))
            layer_draws = replace(layer_draws, carried=carried)
        strength = float(np.median(layer_draws.bevel))
        angled = medium.advance == "path_angle"
        first = planned.steps[0]
        bevel = replace(
            first.bevel, offset=0.0 if angled else strength, cut_angle=strength if angled else 0.0
        )
        rules = replace(make_options(medium), first_cell=planned.lattice.first_cell)
        self._session = Session(
            planned.needle, tissue, bevel, planned.lattice.first_cell, first.controls, rules
        )
        #: needle, median tissue, rules: what commands are checked by; draws vary the tissue
        self.needle, self.tissue, self.rules = planned.needle, tissue, rules
        gain_sd = (errors.gain_sd or GAIN_SD) if gain_sd is None else gain_sd
        self._draws = SteeredDraws.begin(layer_draws, draws, gain_sd, slope_sd, self._rng)
        self._readings: tuple[_Reading, ...] = ()

    @property
    def now(self) -> Step:
        """Depth, bevel and controls as commanded; to be changed by `dataclasses.replace`."""
        return self._session.last

    @property
    def draws(self) -> tuple[ParameterDraws, Floats]:
        """The draws of the parameters and their weights (B,)."""
        return self._draws.to_parameters(), self._draws.weights

    @property
    def effective(self) -> float:
        """The effective number of draws."""
        return self._draws.effective

    def advance(self, inputs: Step | Sequence[Step]) -> Step:
        """Record commanded inputs: one step or several, as `plan` returns; return where the needle stands.

        Raises ModelError, and nothing has changed, if an input is that of another needle, out of its reach,
        or the model finds no needle there.
        """
        session = self._session.copy()
        for step in (inputs,) if isinstance(inputs, Step) else inputs:
            if (step.bevel.offset, step.bevel.cut_angle) != (self.now.bevel.offset, self.now.bevel.cut_angle):
                raise ModelError(
                    "the bevel has another strength than the needle",
                    expected="its side or roll alone changed",
                )
            if step.controls.tip is not None or len(step.controls.guides) != len(self.now.controls.guides):
                raise ModelError(
                    "the step holds the needle by other guides, or by its tip",
                    expected="base and guides of the scene",
                )
            shape = session.go(step)
            if not shape.converged:
                raise ModelError(
                    f"the model finds no needle there ({shape.status})", fix="move less at a time"
                )
        self._session = session
        return self.now

    def measure(self, measured: ArrayLike, kind: Kind = "tip", *, sd: float) -> Learned:
        """Weight the draws by a measurement of the needle as it stands.

        Raises ModelError, and nothing has changed, if it holds other than finite numbers, or lies beyond the
        present depth: of another needle, or in another frame.

        Parameters
        ----------
        measured : (2,), (3,), (K, 2) or (K, 3)
            Of a "tip" its x, y and z, mm; x is checked alone. Of a "shape" x, y and z of points, mm. Of
            "curvatures" the distance from the tip along the needle, mm, then those toward y and z, 1/m.
        kind : "tip", "shape" or "curvatures"
            What was measured.
        sd : float
            Of each value, mm or 1/m, independent of the others.
        """
        if kind not in get_args(Kind) or not sd > 0:
            wanted = f"one of {', '.join(get_args(Kind))}, and an SD above 0"
            raise ModelError(f"{kind!r} with an SD of {sd}", expected=wanted)
        reading = self._read(kind, np.atleast_2d(np.asarray(measured, dtype=np.float64)), sd)
        expected = self._expect(reading, self._draws)
        off = reading.values - expected
        log = _log_likelihood(off, sd)
        readings = (*self._readings, reading)

        def weigh(draws: SteeredDraws) -> Floats:
            expected = ((reading, self._expect(reading, draws)) for reading in readings)
            return np.sum(
                [_log_likelihood(reading.values - place, reading.sd) for reading, place in expected], axis=0
            )

        weights = self._draws.weights
        solved = np.isfinite(log)
        weights = np.where(solved, weights, 0.0) / max(weights[solved].sum(), 1e-300)
        some_off = np.where(solved[:, None, None], off, 0.0)
        mean = np.tensordot(weights, some_off, 1)
        spread = np.sqrt(np.tensordot(weights, (some_off - mean) ** 2, 1) + sd**2)
        self._draws, rounds = self._draws.learn(log, weigh, self._rng)
        self._readings = readings
        return Learned(self._draws.effective, rounds, mean / spread)

    def predict(self, depth: float | None = None) -> TipPrediction:
        """Return the tip at a depth (mm), by default the present one, if the inputs stay as they are.

        Raises ModelError for a depth before the present one, or out of reach.
        """
        depth = self.now.depth if depth is None else depth
        tips = self._find_tips(self._draws.to_parameters(), depth)
        directions = slice(1, 2 if not np.any(tips[:, 2]) else 3)
        chosen = tips[self._draws.choose(len(tips)), directions]
        solved = chosen[np.isfinite(chosen[:, 0])]
        if not len(solved):
            raise ModelError("no draw has a needle there", fix="move less at a time")
        low, high = np.quantile(solved, [0.025, 0.975], axis=0)
        return TipPrediction(depth, solved.mean(axis=0), low, high)

    def plan(
        self,
        target: Sequence[float] | Floats,
        obstacles: Sequence[ObstacleRecord] = (),
        *,
        radius: float = 1.0,
        limits: PlanLimits | None = None,
    ) -> SteeringPlan:
        """Return the rest of the path to a target, x and y, in space z too, mm.

        `probability` is the chance to end within `radius` (mm) of it without touching an obstacle; `misses`
        are the distances of the tips of the draws. Where `hits` is 0 the target is not within reach: the
        least of the misses says how near the needle comes, `at_limit` what keeps it.

        Raises ModelError if the target is not ahead of the tip, or out of the needle's reach.
        """
        insertion = StartedInsertion(
            self.needle, self.tissue, self.rules, self._session.input_path(),
            self._draws.to_parameters(self._draws.choose(len(self._draws.at))),
        )  # fmt: skip
        goal = Goal(tuple(map(float, target)), radius, tuple(obstacles))
        limits = limits or PlanLimits(turns=1)
        return plan_steering(insertion, goal, limits, 1, self._draws.list_sigma_points())

    def jacobian(self, depth: float | None = None) -> Floats:
        """Return the derivatives (3, 4) of the tip, mm, by the inputs from now on, expected over the draws.

        The rows are x, y and z; the columns base y (mm), base slope (1), roll of the bevel (rad) and depth
        (mm), as commanded. The tip is that at a depth (mm), by default the present one. Inputs that are
        stated anew within a cell begin another cut there. By depth it is a difference of 0.001 mm.
        """
        depth = self.now.depth if depth is None else depth
        draws = self._draws.to_parameters(self._draws.choose(min(SEARCH_DRAWS, len(self._draws.at))))
        path = self._session.input_path()
        batch = self._make_batch(draws, (*path, self._ahead(depth)))
        kinds = ("base_y", "base_slope", "roll")
        ((shapes, jacobians),) = linearize_batches([batch], kinds, 1, tracked=False, past=len(path))
        derivatives = differentiate_batch_positions(shapes, jacobians, np.array([depth]))[:, 0]  # (B, 3, 3)
        derivatives[..., :2] *= draws.bending[:, None, None]
        derivatives[:, 1, 0] += 0.0 if draws.carried is None else draws.carried
        deeper = self._find_tips(draws, depth + DEPTH_STEP_MM)
        by_depth = (deeper - self._find_tips(draws, depth)) / DEPTH_STEP_MM
        return np.nanmean(np.concatenate([derivatives, by_depth[..., None]], axis=2), axis=0)

    def _ahead(self, depth: float) -> Step:
        if depth < self.now.depth:
            raise ModelError(
                f"a depth of {depth:g} mm", expected=f"the present depth, {self.now.depth:g} mm, or deeper"
            )
        return replace(self.now, depth=depth)

    def _make_batch(self, draws: ParameterDraws, path: tuple[Step, ...]) -> Batch:
        return draws.make_batch(self.needle, self.tissue, path, self.rules)

    def _find_tips(self, draws: ParameterDraws, depth: float) -> Floats:
        """Return the tips (B, 3) of draws at a depth, mm."""
        path = (*self._session.input_path(), self._ahead(depth))
        (shapes,) = simulate_batches([self._make_batch(draws, path)], 1)
        return draws.find_points(shapes, np.array([depth]), path)[:, 0]

    def _expect(self, reading: _Reading, draws: SteeredDraws) -> Floats:
        parameters = draws.to_parameters()
        (shapes,) = simulate_batches([self._make_batch(parameters, reading.path)], 1)
        return reading.expect(shapes, parameters)

    def _read(self, kind: Kind, table: Floats, sd: float) -> _Reading:
        depth, path = self.now.depth, self._session.input_path()
        rows, columns = table.shape
        if columns not in (2, 3) or not np.isfinite(table).all() or (kind == "tip" and rows > 1):
            raise ModelError(f"a {kind} of shape {table.shape}", expected="finite numbers, 2 or 3 in a row")
        values = table[:, 1 : 2 if self._session.now.shape.w.max() == 0 else 3]
        if kind == "curvatures":
            inside = (table[:, 0] >= SENSOR_STEP_MM) & (table[:, 0] < self.needle.length)
            places = depth - table[:, 0]
        else:
            least = depth - self.needle.length + 1.0 if kind == "shape" else depth - TIP_MARGIN_MM
            inside = (table[:, 0] >= least) & (table[:, 0] <= depth + max(4 * sd, 0.1))
            places = np.array([depth]) if kind == "tip" else np.minimum(table[:, 0], depth)
        if not inside.all():
            wrong = table[np.argmin(inside), 0]
            raise ModelError(
                f"the {kind} has a value at {wrong:.1f} mm, the needle is {depth:.1f} mm deep",
                expected="places on this needle",
                fix="advance to the depth that was measured, or correct the registration",
            )
        return _Reading(kind, path, places, values, sd)


def _log_likelihood(off: Floats, sd: float) -> Floats:
    """Return the log density (B,) of deviations (B, K, D); none of a draw without a needle."""
    log: Floats = -0.5 * np.sum((off / sd) ** 2, axis=(1, 2))
    return np.where(np.isfinite(log), log, -np.inf)


def _draw_table(
    source: Run | MediumRecord, count: int, rng: np.random.Generator
) -> tuple[MediumRecord, pd.DataFrame, TrackErrorsRecord]:
    """Return the tissue model of a source, draws of its parameters (Pa, mm, degrees), errors of tracks."""
    if isinstance(source, MediumRecord):
        parameters = Parameters.from_record(source)
        sets = [parameters.values(theta) for theta in draw_from_prior(parameters, count, rng)]
        return source, pd.DataFrame(sets), TrackErrorsRecord()
    if source.kind not in FIT_KINDS:
        raise ConfigError(f"{source.name} is of kind {source.kind}", expected="a run of a fit or validation")
    stated = source.knows(FitMetadata)
    drawn = draw_insertion(source, stated.folds[0].name, "steering", "", "planned")
    if drawn.table is None:
        raise ConfigError(f"{source.name} has no certified draws", fix="sample it: needlefit.sample(run)")
    return stated.medium, drawn.table, stated.recipe.likelihood.tip_tracks
