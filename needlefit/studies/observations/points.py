"""Predict held-out needles: the predictive distribution of each, compared with its measurement.

A draw of the parameters gives one needle, through the layers that its own planned path meets, with a bevel
offset of its own (given what was measured of the same insertion at other depths, where there is any) and
depths of layers and insertion drawn as the dataset states their errors; about it stand the errors of pose and
points. Specimens differ in their parameters (`Specimens`). The measured shape enters nowhere but as what is
compared (and laid on, where its pose is not known). What the model misses is not predicted: where coverage
falls short of its level, that is why, or the stated errors are too small. A needle is one trial: its tip, and
its shape as a whole, which holds if no point of it leaves the simultaneous band.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.interpolate import PchipInterpolator

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers, find_repeats, list_bevels
from needlefit.geometry.curves import select_compared
from needlefit.grouping import group_values
from needlefit.inference.curve_bands import predict_bands
from needlefit.inference.draw_simulation import (
    DrawnNeedles,
    draw_depth_errors,
    scale_bevels,
    simulate_draws,
    vary_bevels,
)
from needlefit.inference.draws import rms_noise_scale
from needlefit.inference.likelihood.compared_points import Curve, align
from needlefit.inference.likelihood.observation import Observation
from needlefit.inference.likelihood.observations import list_scored, make_observation, measures_tip
from needlefit.inference.likelihood.observations.curvature import surround_sensors
from needlefit.inference.likelihood.pose_errors import draw_rolls, turn_about_x
from needlefit.inference.point_prediction import PointPrediction, choose_point
from needlefit.inference.predictive_mixture import PredictiveMixture, find_geometric_median
from needlefit.inference.prior_shift import POINTS_AS_STORED
from needlefit.inference.problem import Problem
from needlefit.project.callbacks import Step
from needlefit.project.copies import compute_in_copies
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table_files import Row
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.schemas.run_metadata import CountMetadata
from needlefit.studies import fit_figures
from needlefit.studies import scored_groups as scores
from needlefit.studies.fold_draws import Specimens
from needlefit.studies.job import Job
from needlefit.studies.observations import (
    PREDICTIVE_COLUMNS,
    HeldOutPrediction,
    StudiedObservation,
    describe_held_out,
)
from needlefit.studies.prediction_scores import (
    AFTER_ONE_COLUMN,
    CURVATURE_CRPS,
    SHAPE_CRPS,
    SPATIAL_COLUMNS,
    WIDTH_ERROR_COLUMN,
    estimate_width_after_one,
    find_end_error,
    score_tip,
    score_tip_in_space,
    tabulate_band,
    tabulate_sensors,
)
from needlefit.studies.run import FitFrames, Run
from needlefit.studies.score import predict_needle

#: columns that predictions of curvatures, or in space, have besides
FURTHER_COLUMNS = (CURVATURE_CRPS, *SPATIAL_COLUMNS)
MIN_SOLVED_DRAWS = 10  #: smallest number of solved draws that make a distribution


def predict_needles(
    specimens: Specimens, given: Sequence[Insertion], bands: bool, step: Step
) -> Iterator[HeldOutPrediction]:
    """Yield the prediction of every needle, y toward +y of C, mm.

    Of an insertion whose points have no stated noise, nothing: its measurement then has no distribution.
    Nothing is predicted where specimens differ and their draws are not certified, and no band by draws that
    are not. Without `bands`, those are left out, and what one measured insertion into a new specimen would
    leave of the width.
    """
    job, jobs = specimens.job, specimens.jobs
    given = [insertion for insertion in given if job.dataset.noise.stated or insertion.states_errors]
    if given and specimens.faults and (bands or specimens.separate):
        return
    # what is predicted are the stored points, as they will be measured
    predictor = _Predictor(
        specimens,
        job.recipe.likelihood.model_copy(update=POINTS_AS_STORED),
        find_repeats(job.dataset),
        math.ceil(jobs / max(1, len(given))),
        bands,
        _choose_representatives(job, filter(specimens.differs, given)) if bands else frozenset(),
    )
    yield from filter(None, compute_in_copies(predictor.predict, given, jobs, step))


@dataclass(frozen=True)
class _Predictor:
    """Predicts insertions that a fold holds out, each on `jobs` threads."""

    specimens: Specimens
    likelihood: LikelihoodRecord
    repeats: Mapping[str, tuple[str, int]]
    jobs: int
    bands: bool
    representatives: frozenset[str]

    def predict(self, insertion: Insertion) -> HeldOutPrediction | None:
        """Return the prediction of an insertion; None where too few draws have a solution."""
        specimens, job, fold = self.specimens, self.specimens.job, self.specimens.fold
        draws = specimens.draws_in(insertion)
        observation, tip = self._observe(insertion)
        # where needles are read: for the whole, about each sensor, and at a tip measured by itself
        ends = np.empty(0) if tip is None or tip is observation else tip.nodes.s[0]
        stations = [observation.nodes.s[0], surround_sensors(insertion), ends]
        sets = specimens.list_sets(draws)
        drawn_needles = self._simulate(insertion, np.concatenate(stations), *self._vary(insertion, sets))
        rng = job.random(job.name, fold.name, "scored", insertion.id)
        solved = drawn_needles.solved
        if np.sum(solved) < MIN_SOLVED_DRAWS:
            return None
        drawn, directions = drawn_needles.points[solved], job.dataset.directions
        drawn = turn_about_x(drawn, draw_rolls(insertion.roll_sd, directions, len(drawn), rng))
        parts = np.cumsum([len(s) for s in stations])[:-1]
        needles, about_sensors, tips = np.split(select_compared(drawn, job.dataset.compared), parts, axis=1)
        factor = rms_noise_scale(draws, job.parameters, job.recipe.likelihood.noise_scale)
        whole = _PredictedReadings.of(observation, needles, factor)
        bands = predict_bands(whole.mixture.means, whole.covariance, rng)
        row = describe_held_out(specimens, insertion, draws, whole.mixture, whole.measured, bands)
        if tip is not None:
            end = whole if tip is observation else _PredictedReadings.of(tip, tips, factor)
            row |= self._score_tip(end, rng)
            if insertion.id in self.representatives:
                some = [values for values, is_solved in zip(sets, solved, strict=True) if is_solved]
                row[AFTER_ONE_COLUMN] = self._estimate_after_one(insertion, tip, some, end.mixture)
        columns = (*PREDICTIVE_COLUMNS, *(name for name in FURTHER_COLUMNS if name in row))
        band, where = tuple[Row, ...](), {"fold": fold.name, "insertion": insertion.id}
        sensors = tuple({**where, **sensor} for sensor in tabulate_sensors(insertion, about_sensors))
        if self.bands and SHAPE_CRPS in row:
            points = tabulate_band(whole.mixture, bands, observation.measured)
            band = tuple({**where, **point} for point in points)
        row = {name: row.get(name) for name in columns}
        count = CountMetadata(simulations=len(drawn), outside=int(np.sum(~drawn_needles.valid[solved])))
        s = observation.nodes.s[0]
        chosen = self._choose_needle(insertion, s, drawn[:, : len(s)]) if self.bands else ()
        rows = {"predictive": (row,), "bands": band, "curvature": sensors}
        return HeldOutPrediction(insertion.id, rows, count, *chosen)

    def _observe(self, insertion: Insertion) -> tuple[Observation, Observation | None]:
        """Return the observation that is predicted as a whole, and that of the tip, where it was measured.

        The latter is the former, unless the tip was measured by itself. The roll is none of their errors: it
        is drawn, as it turns the needle as a whole.
        """
        scored = list_scored(self.specimens.job.dataset, insertion)
        whole, *others = (
            make_observation(data, replace(alone, roll_sd=0.0), likelihood=self.likelihood)
            for _, data, alone in scored
        )
        observations = zip(scored, (whole, *others), strict=True)
        tips = [observation for part, observation in observations if part.kind.has_tip]
        return whole, tips[-1] if tips else None

    def _vary(
        self, insertion: Insertion, sets: Sequence[Mapping[str, float]]
    ) -> tuple[list[dict[str, float]], np.random.Generator]:
        """Return sets of values with a bevel of this insertion, and what its depths are drawn by."""
        specimens, job, fold = self.specimens, self.specimens.job, self.specimens.fold
        rng = job.random(job.name, fold.name, "foretold", insertion.id)
        # the depths of one insertion have one specimen and one bevel
        repeat = self.repeats.get(insertion.id)
        once = rng if repeat is None else job.random(job.name, fold.name, "foretold", *repeat)
        deviations = once.standard_normal(len(sets))
        if specimens.differs(insertion) and specimens.separate:
            deviations = specimens.bevel_sd_in(insertion) * deviations
        elif fold.tune and len(sets):
            deviations = _condition_bevels(
                specimens.problem_of(insertion), sets, repeat, deviations, self.jobs
            )
        return scale_bevels(sets, deviations), rng

    def _score_tip(self, end: "_PredictedReadings", rng: np.random.Generator) -> Row:
        """Return what became of the prediction of a tip, the last that is read along each direction."""
        directions, count = self.specimens.job.dataset.directions, len(end.measured)
        row = score_tip(end.mixture, end.measured)
        width = row["tip_95_high_mm"] - row["tip_95_low_mm"]  # both of its ends err
        end_error = find_end_error(end.mixture, count // directions)
        row[WIDTH_ERROR_COLUMN] = math.sqrt(2) * end_error * width if math.isfinite(end_error) else math.nan
        if directions == 1:
            return row
        (centre,) = find_geometric_median(end.needles[:, -1:, 1:])
        tips = np.array([count // 2 - 1, count - 1])  # along y and z
        covariance = end.covariance[np.ix_(tips, tips)]
        errors = rng.multivariate_normal(np.zeros(2), covariance, len(end.needles))
        return row | score_tip_in_space(end.needles[:, -1, 1:] + errors, centre, end.measured[tips])

    def _choose_needle(
        self, insertion: Insertion, s: Floats, drawn: Floats
    ) -> tuple[PointPrediction, Curve | None, Curve | None]:
        """Return which needle is reported, its curve, and the mode's; draws are `drawn` (B, K, 3) at `s`."""
        job, mode = self.specimens.job, self.specimens.mode_in(insertion)
        problem, across = job.problem(self.specimens.fold), slice(1, 1 + job.dataset.directions)
        assert mode is not None

        def simulate(theta: Floats) -> Curve | None:
            return predict_needle(problem.values(theta), job.medium, insertion)

        def predict(theta: Floats) -> Floats:
            curve = needle if theta is mode else simulate(theta)
            return np.full_like(drawn[0, :, across], np.nan) if curve is None else curve(s)[:, across]

        if (needle := simulate(mode)) is None:
            return PointPrediction(), None, None
        point = choose_point(problem, mode, drawn[..., across], predict)
        if not point.is_median:
            return point, needle, needle
        places, median = s, point.take(needle(s), drawn)
        if places[0] > 0:  # of a tip or of sensors; the needle begins at the entry
            places, median = np.append(0.0, s), np.vstack([np.zeros(3), median])
        return point, PchipInterpolator(places, median), needle

    def _simulate(
        self,
        insertion: Insertion,
        s: Floats,
        sets: Sequence[Mapping[str, float]],
        rng: np.random.Generator,
    ) -> DrawnNeedles:
        """Return the needles of sets of values at beam coordinates (K,), each with depths of its own."""
        errors = draw_depth_errors(insertion, len(sets), rng)
        return simulate_draws(sets, self.specimens.job.medium, insertion, s, *errors, self.jobs)

    def _estimate_after_one(
        self,
        insertion: Insertion,
        observation: Observation,
        sets: Sequence[Mapping[str, float]],
        first: PredictiveMixture,
    ) -> float:
        """Return the width of the 95 % interval of the tip after one such insertion was measured, mm.

        The second one has the parameters of the `first` (`sets`, before its bevel was drawn), and a bevel,
        depths and errors of measurement of its own.
        """
        job, fold = self.specimens.job, self.specimens.fold
        # a stream of its own: no other number depends on it
        rng = job.random(job.name, fold.name, "after one", insertion.id)
        further = vary_bevels(sets, self.specimens.bevel_sd_in(insertion), rng)
        tip = len(observation.measured) - 1
        simulated = self._simulate(insertion, observation.nodes.s[0], further, rng)
        again = np.full(len(sets), np.nan)
        points = select_compared(simulated.points[simulated.solved], job.dataset.compared)
        aligned = align(observation.pose, points, observation.measured)
        again[simulated.solved] = aligned[:, -1, 1]
        errors = first.sd[tip] * rng.standard_normal((2, len(sets)))
        return estimate_width_after_one(again + errors[0], first.means[:, tip] + errors[1])


@dataclass(frozen=True)
class _PredictedReadings:
    """What is predicted of an observation by draws."""

    needles: Floats  #: (B, K, 2 or 3), as its pose allows them to lie beside the measured points
    measured: Floats  #: (C,)
    covariance: Floats  #: (C, C) of the errors of what was measured
    mixture: PredictiveMixture

    @classmethod
    def of(cls, observation: Observation, needles: Floats, factor: float) -> Self:
        """Return what an observation reads of needles (B, K, 2 or 3); `factor` multiplies its noise.

        A needle that is laid on the measured one takes from the errors what its motion can.
        """
        aligned, measured = align(observation.pose, needles, observation.measured), observation.measured
        covariance = observation.covariance(factor)
        if observation.pose != "known":
            moved_by: Floats = np.linalg.qr(observation.free)[0]  # (K, f): across, turn
            left = np.eye(len(moved_by)) - moved_by @ moved_by.T
            covariance = left @ covariance @ left
        mixture = PredictiveMixture(observation.read(aligned), np.sqrt(np.diag(covariance)))
        return cls(aligned, observation.read(measured), covariance, mixture)


def _choose_representatives(job: Job, insertions: Iterable[Insertion]) -> frozenset[str]:
    """Return the insertion with a tip of median depth of each medium and number of layers, by its id."""
    rule = job.record.layer_count_rule
    groups = group_values(
        ((with_tip.medium, count_layers(with_tip, rule)), with_tip)
        for with_tip in filter(measures_tip, insertions)
    )
    ordered = (
        sorted(some, key=lambda insertion: (insertion.depth, insertion.id)) for some in groups.values()
    )
    return frozenset(some[(len(some) - 1) // 2].id for some in ordered)


def _condition_bevels(
    problem: Problem,
    sets: Sequence[Mapping[str, float]],
    repeat: tuple[str, int] | None,
    deviations: Floats,
    jobs: int,
) -> Floats:
    """Return by how many SDs (B,) the bevel of an insertion deviates, from standard normal `deviations`.

    `own` names it where it was measured at several depths. What was fitted to may be one of them.
    """
    fitted = list_bevels(problem.dataset, problem.insertions)
    if repeat not in fitted:
        return problem.new_bevel_sd * deviations
    if len(set(fitted)) == 1:
        return 0.0 * deviations
    mean, sd = problem.density.estimate_bevel(sets, repeat, jobs)
    # with a set that has no solution nothing is predicted
    return np.nan_to_num(mean + sd * deviations)


def draw_needles(run: Run, role: str) -> dict[str, Drawing]:
    """Return the insertions with the smallest, middle and largest tip error, and all of them."""
    if FitFrames.of(run).select_curves(role=role, method="fitted").empty:
        return {}
    names = ("overlays", "overlays_above")[: scores.count_directions(run)]
    overlays = {name: fit_figures.draw_overlays(run, from_above=name != names[0]) for name in names}
    return {"insertions": fit_figures.draw_first_page(run), **overlays}


POINTS = StudiedObservation("points", draw_needles, predict_needles)
