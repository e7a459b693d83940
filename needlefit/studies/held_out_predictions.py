"""Predict held-out needles: the predictive distribution of each, compared with its measurement.

A draw of the parameters gives one needle, through the layers that its own planned path meets, with a bevel
offset of its own (given what was measured of the same insertion at other depths, where there is any) and
depths of layers and insertion drawn as the dataset states their errors; about it stand the errors of pose and
points. Specimens differ in their parameters (`Specimens`). The measured shape enters nowhere but as what is
compared (and laid on, where its pose is free). What the model misses is not predicted: where coverage falls
short of its level, that is why, or the stated errors are too small. A needle is one trial: its tip, and its
shape as a whole, which holds if no point of it leaves a band that the predicted probability of such needles
stays within all along.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import scipy
from scipy.spatial.distance import pdist

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers, find_repeats, list_bevels, name_holes
from needlefit.errors import ConfigError
from needlefit.grouping import group_values
from needlefit.inference import specimens
from needlefit.inference.compared_points import Curve, align, pad_planes, turn_about_x
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.identifiability.precision import add_estimated_noise
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.likelihood.observation import (
    SENSOR_STEP_MM,
    Observation,
    append_sensors,
    make_observation,
)
from needlefit.inference.optimize import minimize
from needlefit.inference.predict import (
    INTERVAL_PROBABILITIES,
    Draws,
    PredictiveMixture,
    cdf,
    crps,
    find_geometric_median,
    interval,
    quantile,
    rms_noise_scale,
    simulate_shape_pit,
    thin_posterior,
)
from needlefit.inference.problem import Problem, find_new_bevel_sd
from needlefit.inference.sampling.importance import (
    LARGER_EFFORT,
    Effort,
    WeightedDraws,
    resample_draws,
    sample_about_fit,
    sample_about_modes,
)
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample
from needlefit.project.checkpoint import NO_CHECKPOINT, Checkpoint
from needlefit.project.progress import never_stop
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import TaskStop, run_parts
from needlefit.project.toml import describe_key
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.studies.coverage import estimate_width_after_one
from needlefit.studies.fit_frames import COLUMNS, NEW_SPECIMEN
from needlefit.studies.job import Fold, Job, Settings, group_insertions
from needlefit.studies.planned_draws import (
    PlannedInsertion,
    PlannedNeedles,
    draw_depth_errors,
    scale_bevels,
    vary_bevels,
)
from needlefit.studies.score import Row

PREDICTION_DRAWS = 1000  #: parameter sets of which a needle is predicted
#: of these, one in so many predicts a needle that is held out; the next of these strides, and in the end all,
#: where an end of the tip's 95 % interval has a Monte Carlo error above this part of the interval's width
DRAW_STRIDES, MAX_END_ERROR = (8, 2), 0.1
#: of one specimen by itself: where its posterior overlaps with the others', few of its draws lie
SPECIMEN_EFFORTS = (Effort(draws=500, min_ess=1000.0), LARGER_EFFORT)


def find_fit(job: Job, problem: Problem, key: tuple[str, ...], settings: Settings) -> Fit:
    """Fit the free parameters of a problem by the recipe of the job; `key` keys the random streams.

    Raises FitError if the search finds no point that can be solved.
    """
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    return minimize(problem, job.recipe, random_stream(job.recipe.seed, job.name, *key, "starts"), callbacks)


def sample_posterior(
    job: Job,
    problem: Problem,
    fit: Fit,
    begin: WeightedDraws,
    key: tuple[str, ...],
    settings: Settings,
    checkpoint: Checkpoint = NO_CHECKPOINT,
    step: Callable[[int, int], None] = lambda done, total: None,
) -> Posterior | None:
    """Return the posterior by MCMC, from weighted draws about a fit; None after a stop before there is any.

    `step` is called with the number of steps made, and of all.
    """
    known = add_estimated_noise(problem, np.array(fit.theta))
    rng = random_stream(job.recipe.seed, *key, "posterior")
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs)
    # of another fit with the same key the chain would be another
    name = f"{'/'.join(key)} about {fit.theta}"
    return sample(known, begin, job.recipe.sample, rng, callbacks, checkpoint, name)


@dataclass
class Specimens:
    """The parameters of a fold in its specimens: in those that were tuned on, and in a further one.

    With a spread between specimens, several that were tuned on have parameters of their own, each; then
    `draws` of the posterior of all insertions together are of no specimen, whether certified or not. What was
    found is kept.
    """

    job: Job
    fold: Fold
    draws: Draws = field(default_factory=partial(Draws, np.empty((0, 0)), "importance"))
    jobs: int = 1  #: threads
    #: draws of the posterior of each specimen by itself, by its insertions; folds may share them
    posteriors: dict[tuple[str, ...], Draws] = field(default_factory=dict)

    @cached_property
    def tuned(self) -> dict[str, tuple[Insertion, ...]]:
        return group_insertions(self.fold.tune, "specimen")

    @cached_property
    def model(self) -> specimens.SpreadModel:
        """Which parameters differ between specimens, and the prior of their spread."""
        problem, near = self.job.problem(self.fold), self.draws.thetas
        begin = problem.parameters.expected
        theta = near.mean(axis=0) if near.size else minimize_squares(problem, begin).theta
        return specimens.make_spread_model(problem, self.job.recipe.specimens, theta)

    @property
    def separate(self) -> bool:
        """Whether the specimens that were tuned on differ."""
        return self.job.record.specimens == "others" and len(self.tuned) > 1 and len(self.model.names) > 0

    def differs(self, insertion: Insertion) -> bool:
        """Return whether an insertion goes into a specimen that was not tuned on, and may differ."""
        return self.job.record.specimens == "others" and insertion.specimen not in self.tuned

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the draws by which insertions are predicted are not certified; empty if they are."""
        return self.population.faults if self.separate else self.draws.faults

    @cached_property
    def population(self) -> specimens.PopulationDraws:
        """As many joint draws of all specimens as there are `draws`."""
        posteriors = {"": self.draws.thetas}
        count = len(self.draws.thetas) or PREDICTION_DRAWS  # none where all together have no certified ones
        faults: list[str] = []
        if self.separate:
            wanted = {name: tuple(one.id for one in group) for name, group in self.tuned.items()}
            missing = [name for name, ids in wanted.items() if ids not in self.posteriors]
            found = dict(run_parts(self._sample_specimen, missing, self.jobs, TaskStop(never_stop)))
            self.posteriors |= {wanted[name]: found[n] for n, name in enumerate(missing)}
            known = {name: self.posteriors[ids] for name, ids in wanted.items()}
            posteriors = {name: one.thetas for name, one in known.items()}
            faults = [f"specimen {name}: {fault}" for name, one in known.items() for fault in one.faults]
        rng = random_stream(self.job.recipe.seed, self.fold.name, "specimens", count)
        if faults:
            nothing = np.empty((0, len(self.job.parameters.free)))
            empty = np.empty((0, len(self.model.names), len(self.model.names)))
            return specimens.PopulationDraws({}, nothing, nothing, empty, tuple(faults))
        return specimens.draw_population(self.job.parameters, self.model, posteriors, count, rng)

    def tabulate_population(self) -> list[Row]:
        """Return how much each parameter differs between several specimens; nothing if that is uncertain."""
        found = self.population
        if found.faults:
            return []
        correlation = found.correlation if self.model.correlated else np.nan
        about = {"between_correlation": correlation, "other_specimens": len(self.tuned)}
        return [
            {"fold": self.fold.name, "parameter": name, "between_sd": sd, **about}
            for name, sd in zip(self.model.names, found.rms.tolist(), strict=True)
        ]

    def draws_in(self, insertion: Insertion | None) -> Draws:
        """Return draws in the specimen of an insertion; of None in one that is not in the dataset."""
        if insertion is None or self.differs(insertion):
            return self._describe(self.population.new)
        found = self.population.tuned.get(insertion.specimen) if self.separate else None
        return self.draws if found is None else self._describe(found)

    def replace_mean(self, draws: Draws) -> Draws:
        """Return draws of the specimens' mean in place of as many draws of all insertions together."""
        if not self.separate:
            return draws
        if self.faults:
            return replace(draws, faults=self.faults)
        return self._describe(self.population.mean[: len(draws.thetas)])

    def _describe(self, thetas: Floats) -> Draws:
        """Return draws (B, P) of the population with how they were made."""
        if not self.separate:
            return replace(self.draws, thetas=thetas)
        found = self.population
        return Draws(thetas, "importance", found.faults, found.pareto_k, found.effective_sample_size)

    def list_draws(self, thetas: Floats) -> dict[str, Floats]:
        """Return as many draws (B, P) in each specimen that has some of its own, and in a `NEW_SPECIMEN`.

        `thetas` (B, P) are draws of all insertions together, about which a single specimen's lie.
        """
        about = replace(self.draws, thetas=thetas)
        found = self.population if self.separate else replace(self, draws=about).population
        own = found.tuned if self.separate else {}
        return {name: some[: len(thetas)] for name, some in {**own, NEW_SPECIMEN: found.new}.items()}

    def problem_of(self, insertion: Insertion | None) -> Problem:
        """Return the problem whose bevels an insertion's is one of: of its specimen, or of all tuned on."""
        everything = self.job.problem(self.fold)
        own = self.tuned.get(insertion.specimen) if insertion is not None and self.separate else None
        return everything if own is None else replace(everything, insertions=own)

    def bevel_sd_in(self, insertion: Insertion | None) -> float:
        """By how many SDs a further bevel in the specimen of an insertion deviates, as an SD; None: a new."""
        everything = self.job.problem(self.fold)
        if insertion is not None and not self.differs(insertion):
            return self.problem_of(insertion).new_bevel_sd
        if not (self.separate and everything.bevels_differ and everything.centred_bevels):
            return everything.new_bevel_sd
        return find_new_bevel_sd(everything.dataset, everything.insertions, new_specimen=True)

    def _sample_specimen(self, specimen: str) -> Draws:
        """Return draws of the posterior of one specimen by itself: about one mode, else about all."""
        job, key = self.job, ("specimen", specimen)
        problem = replace(job.problem(self.fold), insertions=self.tuned[specimen])
        begin, easier = job.parameters.expected, problem.approach("posterior")
        near = begin if easier is None else minimize_squares(easier, begin).theta
        minimum = minimize_squares(problem, near)
        rng = random_stream(job.recipe.seed, *key)
        if minimum.converged:
            known = add_estimated_noise(problem, minimum.theta)
            found = sample_about_modes(
                known, [minimize_squares(known, minimum.theta)], rng, efforts=SPECIMEN_EFFORTS
            )
            if found.certified:
                return resample_draws(found, PREDICTION_DRAWS, rng)
        fit = find_fit(job, problem, key, Settings())
        rng = random_stream(job.recipe.seed, job.name, *key, "weighed")
        found = sample_about_fit(problem, fit, rng)
        if found.certified:
            return resample_draws(found, PREDICTION_DRAWS, rng)
        posterior = sample_posterior(job, problem, fit, found, key, Settings())
        if posterior is None:
            return Draws(np.empty((0, len(fit.theta))), "posterior")
        return thin_posterior(posterior, job.parameters, PREDICTION_DRAWS, found.k)


def choose_specimen(known: Specimens, into: str) -> Insertion | None:
    """Return an insertion tuned on in the specimen named `into`; None for a "new" one.

    Where specimens do not differ, other words are any of those tuned on.

    Raises ConfigError if specimens differ, and `into` names none of them.
    """
    if into == "new":
        return None
    if into not in known.tuned and (known.separate or into not in ("same", "training only")):
        words = "each has parameters of its own" if known.separate else f"{into!r} is none of them"
        raise ConfigError(
            f"the specimens tuned on are {', '.join(known.tuned)}: {words}",
            where=describe_key(known.job.name, "specimen"),
            key="specimen",
            expected=f"new, or one of {', '.join(known.tuned)}",
        )
    return known.tuned.get(into, known.fold.tune)[0]


def describe_specimen(new: Specimens | None, otherwise: str = "same") -> Row:
    """Return what a prediction knows of its specimen, a new one; `otherwise` is what it is called without."""
    mu, b, correlation, count, treatment = np.nan, np.nan, np.nan, np.nan, otherwise
    if new is not None:
        model, treatment = new.model, "others"
        count = float(len(new.tuned) if new.separate else 0)
        sds = new.population.rms
        mu = float(sds[0]) if model.moduli else 0.0
        b = float(sds[model.moduli]) if len(sds) > model.moduli else 0.0
        correlation = new.population.correlation if new.separate and model.correlated else np.nan
    return {
        "specimen_treatment": treatment,
        "between_sd_ln_mu": mu,
        "between_sd_ln_b": b,
        "between_correlation": correlation,
        "other_specimens": count,
    }


FIGURE_DRAWS = 400  #: parameter sets that a figure of the posterior shows
MIN_SOLVED_DRAWS = 10  #: fewer solved draws make no distribution
#: expected width of the 95 % interval of the tip after one measured insertion into the new specimen
AFTER_ONE_COLUMN = "tip_95_width_after_one_mm"


@dataclass(frozen=True)
class FoldDraws:
    """Draws of the parameters of a fold, to predict with and for figures, and how they came about."""

    draws: Draws  #: `PREDICTION_DRAWS` of them
    shown: Draws  #: `FIGURE_DRAWS` of them
    posterior: Posterior | None = None  #: where it was sampled


def draw_fold_parameters(
    job: Job,
    fold: Fold,
    fit: Fit,
    settings: Settings,
    checkpoint: Checkpoint = NO_CHECKPOINT,
    step: Callable[[int, int], None] = lambda done, total: None,
) -> FoldDraws:
    """Draw parameters of a fold by importance sampling about its fit.

    Where the settings ask for it, or the weights are not certified, an ensemble of walkers goes on from these
    draws. Its draws are used if it has converged, or those by importance are not certified. `checkpoint` and
    `step` are the ensemble's.
    """
    counts = (PREDICTION_DRAWS, FIGURE_DRAWS)
    if not len(fit.theta):
        few, many = (Draws(np.empty((count, 0)), "importance") for count in counts)
        return FoldDraws(few, many)
    # not keyed by the job's name: the same fit has the same draws, whichever command runs it
    key, problem = (fold.name, "draws"), job.problem(fold)
    rng = random_stream(job.recipe.seed, *key)
    found = sample_about_fit(problem, fit, rng, settings.jobs)
    # both sets come from one generator: their order is part of the result
    few, many = (resample_draws(found, count, rng) for count in counts)
    posterior = None
    if (settings.sample or not found.certified) and not settings.stop():
        posterior = sample_posterior(job, problem, fit, found, key, settings, checkpoint, step)
    if posterior is not None and not (posterior.faults and found.certified):
        few, many = (thin_posterior(posterior, job.parameters, count, found.k) for count in counts)
    return FoldDraws(few, many, posterior)


BAND_POINTS = 41  #: points of a band that are kept, of up to some 200


@dataclass(frozen=True)
class HeldOutPrediction:
    """The prediction of one needle: its rows of the tables "predictive", "bands", "curvature" (`fit_frames`).

    `solved` needles were simulated, one a draw, `outside` of them outside what the model assumes.
    """

    row: Row
    band: tuple[Row, ...]
    sensors: tuple[Row, ...]
    solved: int
    outside: int
    #: with bands, the predictive median as a curve: beam coordinates (K,) -> points (K, 2) in C, mm. x is the
    #: median over draws, y that of what will be measured, each at its own beam coordinate
    median: Curve | None


def predict_held_out(
    known: Specimens,
    *,
    bands: bool = False,
    step: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[HeldOutPrediction]:
    """Yield the prediction of every insertion that a fold holds out, y toward +y of C, mm.

    Of an insertion whose points have no stated noise, nothing: its measurement then has no distribution.
    Nothing is predicted where specimens differ and their draws are not certified. Without `bands`, those are
    left out, and what one measured insertion into a new specimen would leave of the width. `step` is called
    with the number of predictions made, and of all.
    """
    job, jobs = known.job, known.jobs
    given = [one for one in known.fold.validate if job.dataset.noise.stated or one.sd is not None]
    if given and known.separate and known.faults:
        return
    side_by_side = max(1, min(jobs, len(given)))
    # what is predicted are the stored points, as they will be measured
    update = {"depths": "fixed", "bevel_spread": 0.0, "measurement": "points"}
    predictor = _Predictor(
        known,
        job.recipe.likelihood.model_copy(update=update),
        find_repeats(job.dataset),
        jobs // side_by_side,
        bands,
        _choose_representatives(job, filter(known.differs, given)) if bands else frozenset(),
    )
    found: dict[int, HeldOutPrediction | None] = {}
    for n, one in run_parts(predictor.predict, given, side_by_side, TaskStop(never_stop)):
        found[n] = one
        step(len(found), len(given))
    yield from filter(None, (found[n] for n in range(len(given))))


@dataclass(frozen=True)
class _Predictor:
    """Predicts insertions that a fold holds out, each on `jobs` threads."""

    known: Specimens
    likelihood: LikelihoodRecord
    repeats: Mapping[str, tuple[str, int]]
    jobs: int
    bands: bool
    representatives: frozenset[str]

    def predict(self, insertion: Insertion) -> HeldOutPrediction | None:
        """Return the prediction of an insertion; None where too few draws have a solution."""
        known, job, planes = self.known, self.known.job, self.known.job.dataset.planes
        draws = known.draws_in(insertion)
        # in space the roll is drawn: it turns the needle as a whole
        points = replace(insertion, curvature=None, roll_sd=0.0 if planes == 2 else insertion.roll_sd)
        observation = make_observation(job.dataset, points, likelihood=self.likelihood)
        sets = [job.parameters.values(theta) for theta in draws.thetas]
        stations = append_sensors(insertion, observation.nodes.s[0])
        needles = self._plan(insertion, stations, *self._vary(insertion, sets))
        # the width after one more insertion is estimated from neighbouring draws, which takes all of them
        for stride in () if insertion.id in self.representatives else DRAW_STRIDES:
            some = replace(draws, thetas=draws.thetas[::stride])
            found = self._predict(insertion, observation, some, needles.simulate(stride), MAX_END_ERROR)
            if found is not None:
                return found
        return self._predict(insertion, observation, draws, needles.simulate())

    def _vary(
        self, insertion: Insertion, sets: Sequence[Mapping[str, float]]
    ) -> tuple[list[dict[str, float]], np.random.Generator]:
        """Return sets of values with a bevel of this insertion, and what its depths are drawn by."""
        known, job, fold = self.known, self.known.job, self.known.fold
        rng = random_stream(job.recipe.seed, job.name, fold.name, "foretold", insertion.id)
        # the depths of one insertion have one specimen and one bevel
        own = self.repeats.get(insertion.id)
        once = rng if own is None else random_stream(job.recipe.seed, job.name, fold.name, "foretold", *own)
        deviations = once.standard_normal(len(sets))
        if known.differs(insertion) and known.separate:
            deviations = known.bevel_sd_in(insertion) * deviations
        elif fold.tune and len(sets):
            deviations = _condition_bevels(known.problem_of(insertion), sets, own, deviations, self.jobs)
        return scale_bevels(sets, deviations), rng

    def _predict(
        self,
        insertion: Insertion,
        observation: Observation,
        draws: Draws,
        found: PlannedNeedles,
        max_end_error: float = math.inf,
    ) -> HeldOutPrediction | None:
        """Return the prediction by some draws; None also where an interval's ends err by more than wanted."""
        known, job, fold = self.known, self.known.job, self.known.fold
        rng = random_stream(job.recipe.seed, job.name, fold.name, "scored", insertion.id)
        planes = job.dataset.planes
        tuned = any(insertion.specimen == one.specimen for one in fold.tune)
        differing = known if known.differs(insertion) else None
        about = describe_specimen(differing, "same" if tuned else "training only")
        s = observation.nodes.s[0]
        solved = found.solved
        if np.sum(solved) < MIN_SOLVED_DRAWS:
            return None
        needles = pad_planes(found.points[solved], planes)
        if planes == 2:
            needles = turn_about_x(needles, insertion.roll_sd * rng.standard_normal(len(needles)))
        needles, about_sensors = needles[:, : len(s)], needles[:, len(s) :]
        aligned = align(observation.pose, needles, observation.measured)
        factor = rms_noise_scale(draws, job.parameters, job.recipe.likelihood.noise_scale)
        covariance = _measurement_covariance(observation, factor)
        measured = observation.stack(observation.measured)
        mixture = PredictiveMixture(observation.stack(aligned), np.sqrt(np.diag(covariance)))
        if max_end_error < math.inf and _find_end_error(mixture, len(observation.measured)) > max_end_error:
            return None
        row = {
            "fold": fold.name,
            "insertion": insertion.id,
            "hole": name_holes(job.dataset).get(insertion.id, insertion.id),
            "specimen": insertion.specimen,
            "medium": insertion.medium,
            "layers": count_layers(insertion, job.record.layer_count_rule),
            "depth_mm": insertion.depth,
            "draw_source": draws.source,
            "certified": not draws.faults,
            "draws": len(draws.thetas),
            "failed_solves": int(np.sum(~solved)),
            AFTER_ONE_COLUMN: math.nan,
            **about,
        }
        if insertion.id in self.representatives:
            some = [job.parameters.values(theta) for theta in draws.thetas[solved]]
            row[AFTER_ONE_COLUMN] = self._estimate_after_one(insertion, observation, some, mixture)
        row |= _score_prediction(mixture, measured, simulate_shape_pit(mixture, covariance, measured, rng))
        across: Floats = quantile(mixture, (0.5,)).T
        columns: tuple[str, ...] = COLUMNS["predictive"]
        if planes == 2:
            across = find_geometric_median(aligned[..., 1:])
            tips = np.array([len(measured) // 2 - 1, len(measured) - 1])  # along y and z
            errors = rng.multivariate_normal(np.zeros(2), covariance[np.ix_(tips, tips)], len(aligned))
            row |= _score_tip_in_space(aligned[:, -1, 1:] + errors, across[-1], measured[tips])
            columns = (*columns, *SPATIAL_COLUMNS)
        band, median, where = tuple[Row, ...](), None, {"fold": fold.name, "insertion": insertion.id}
        sensors = tuple({**where, **one} for one in _sensor_rows(insertion, about_sensors))
        if self.bands:
            band = tuple({**where, **point} for point in _band_rows(mixture, observation.measured))
            middle = np.column_stack([np.median(aligned[..., 0], axis=0), across])
            median = partial(_interpolate, s, middle)
        row = {name: row[name] for name in columns}
        outside = int(np.sum(~found.valid[solved]))
        return HeldOutPrediction(row, band, sensors, len(aligned), outside, median)

    def _plan(
        self,
        insertion: Insertion,
        s: Floats,
        sets: Sequence[Mapping[str, float]],
        rng: np.random.Generator,
    ) -> PlannedInsertion:
        """Return the needles of sets of values at beam coordinates (K,), each with depths of its own."""
        deep, wrong = draw_depth_errors(insertion, len(sets), rng)
        medium, needle = self.known.job.medium, self.known.job.dataset.needle
        return PlannedInsertion(sets, medium, needle, insertion, s, deep, wrong, self.jobs)

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
        job, fold = self.known.job, self.known.fold
        # a stream of its own: no other number depends on it
        rng = random_stream(job.recipe.seed, job.name, fold.name, "after one", insertion.id)
        further = vary_bevels(sets, self.known.bevel_sd_in(insertion), rng)
        found = self._plan(insertion, observation.nodes.s[0], further, rng).simulate()
        again, tip = np.full(len(sets), np.nan), len(observation.measured) - 1
        aligned = align(observation.pose, found.points[found.solved], observation.measured)
        again[found.solved] = aligned[:, -1, 1]
        errors = first.sd[tip] * rng.standard_normal((2, len(sets)))
        return estimate_width_after_one(again + errors[0], first.means[:, tip] + errors[1])


def _interpolate(known: Floats, points: Floats, s: Floats) -> Floats:
    """Return the points (K, D) of a curve at `s` (K,); `points` are those at `known`."""
    return np.column_stack([np.interp(s, known, along) for along in points.T])


def _choose_representatives(job: Job, insertions: Iterable[Insertion]) -> frozenset[str]:
    """Return the insertion of median depth of each medium and number of layers, by its id."""
    rule = job.record.layer_count_rule
    groups = group_values(((one.medium, count_layers(one, rule)), one) for one in insertions)
    ordered = (sorted(some, key=lambda one: (one.depth, one.id)) for some in groups.values())
    return frozenset(some[(len(some) - 1) // 2].id for some in ordered)


def _condition_bevels(
    problem: Problem,
    sets: Sequence[Mapping[str, float]],
    own: tuple[str, int] | None,
    deviations: Floats,
    jobs: int,
) -> Floats:
    """Return by how many SDs (B,) the bevel of an insertion deviates, from standard normal `deviations`.

    `own` names it where it was measured at several depths. What was fitted to may be one of them.
    """
    fitted = list_bevels(problem.dataset, problem.insertions)
    if own not in fitted:
        return problem.new_bevel_sd * deviations
    if len(set(fitted)) == 1:
        return 0.0 * deviations
    mean, sd = problem.density.estimate_bevel(sets, own, jobs)
    # with a set that has no solution nothing is predicted
    return np.nan_to_num(mean + sd * deviations)


def _measurement_covariance(observation: Observation, factor: float) -> Floats:
    """Return the covariance of the measured deflections about a given needle: of points, and of a known pose.

    A free shape or tip track is laid on the measured one, which takes from its errors what a motion can.
    """
    covariance = observation.covariance(factor)
    if observation.pose == "known":
        return covariance
    moved_by: Floats = np.linalg.qr(observation.free)[0]  # (K, 2): across, turn
    left = np.eye(len(moved_by)) - moved_by @ moved_by.T
    aligned: Floats = left @ covariance @ left
    return aligned


def _band_rows(mixture: PredictiveMixture, measured: Floats) -> Iterator[Row]:
    """Yield median and intervals at some of the measured points (K, 2 or 3), the tip the last."""
    kept = np.unique(np.linspace(0, len(measured) - 1, BAND_POINTS).round().astype(np.int64))
    columns = {"x_mm": measured[kept, 0]}
    for plane, ending in enumerate(("mm", "z_mm")[: measured.shape[1] - 1]):
        rows = kept + plane * len(measured)
        median, intervals = _find_intervals(PredictiveMixture(mixture.means[:, rows], mixture.sd[rows]))
        columns |= {f"measured_{ending}": measured[kept, 1 + plane], f"median_{ending}": median}
        for level, (low, high) in intervals.items():
            columns |= {f"low_{100 * level:.0f}_{ending}": low, f"high_{100 * level:.0f}_{ending}": high}
    for k in range(len(kept)):
        yield {name: float(values[k]) for name, values in columns.items()}


def _sensor_rows(insertion: Insertion, about: Floats) -> Iterator[Row]:
    """Yield the curvature at each sensor, from simulated points (B, 3 n, 2 or 3) about the n sensors."""
    if insertion.curvature is None:
        return
    from_tip, *measured, sd = insertion.curvature.T
    across = about.reshape(len(about), len(sd), 3, -1)[..., 1:]
    bent = np.diff(across, n=2, axis=2)[:, :, 0] / SENSOR_STEP_MM**2  # (B, n, planes)
    for plane, direction in enumerate(("y", "z")[: bent.shape[-1]]):
        mixture = PredictiveMixture(bent[..., plane], sd)
        low, high = interval(mixture, 0.95)
        for k, kappa in enumerate(measured[plane]):
            yield {
                **{"s_mm": insertion.depth - from_tip[k], "direction": direction, "kappa_1_per_mm": kappa},
                "kappa_predicted_1_per_mm": mixture.means[:, k].mean(),
                "kappa_sd_1_per_mm": math.hypot(mixture.means[:, k].std(), sd[k]),
                "kappa_in_95": bool(low[k] <= kappa <= high[k]),
            }


def _find_intervals(mixture: PredictiveMixture) -> tuple[Floats, dict[float, Floats]]:
    """Return the median (K,), and by level the ends (2, K) of the intervals: one search finds them all."""
    ends = [(1 + side * level) / 2 for level in INTERVAL_PROBABILITIES for side in (-1, 1)]
    median, *found = quantile(mixture, (0.5, *ends))
    pairs = np.array(found).reshape(len(INTERVAL_PROBABILITIES), 2, -1)
    return median, dict(zip(INTERVAL_PROBABILITIES, pairs, strict=True))


#: columns that predictions in space have besides; there `tip_pit` is the probability of a tip nearer to the
#: centre, by the spread of tips, `tip_crps_mm` the energy score, and `tip_in_95` is by `tip_pit`
SPATIAL_COLUMNS = ("tip_z_measured_mm", "tip_z_median_mm", "tip_z_95_low_mm", "tip_z_95_high_mm")


def _score_tip_in_space(tips: Floats, centre: Floats, measured: Floats) -> Row:
    """Return what became of the prediction of a tip (2,) across the needle, by predicted tips (B, 2).

    The energy score is mean |X - y| - mean |X - X'| / 2 (T. Gneiting, A. E. Raftery, JASA 102 (2007) 359).
    """
    root = np.linalg.cholesky(np.cov(tips.T))
    sizes = np.linalg.norm(np.linalg.solve(root, (tips - centre).T), axis=0)
    pit = float(np.mean(sizes < np.linalg.norm(np.linalg.solve(root, measured - centre))))
    apart = pdist(tips).mean() * (len(tips) - 1) / len(tips)
    low, high = np.quantile(tips[:, 1], [0.025, 0.975]).tolist()
    ends: Row = {}
    for level in INTERVAL_PROBABILITIES:  # along y
        pair = np.quantile(tips[:, 0], [(1 - level) / 2, (1 + level) / 2]).tolist()
        ends |= {
            f"tip_{100 * level:.0f}_{end}_mm": one for end, one in zip(("low", "high"), pair, strict=True)
        }
    (y, z), (y_median, z_median) = measured.tolist(), centre.tolist()
    return {
        **{"tip_measured_mm": y, "tip_median_mm": y_median},
        **{"tip_z_measured_mm": z, "tip_z_median_mm": z_median},
        **{"tip_z_95_low_mm": low, "tip_z_95_high_mm": high, **ends},
        **{"tip_pit": pit, "tip_in_50": pit <= 0.5, "tip_in_95": pit <= 0.95},
        "tip_crps_mm": float(np.linalg.norm(tips - measured, axis=1).mean() - apart / 2),
        "tip_interval_score_mm": math.nan,
    }


def _find_end_error(mixture: PredictiveMixture, count: int) -> float:
    """Return the Monte Carlo error of the ends of the tip's widest interval, in parts of its width.

    Of two planes, with `count` points in each, the larger one.
    """
    tips = slice(count - 1, None, count)
    tip = PredictiveMixture(mixture.means[:, tips], mixture.sd[tips])
    if not tip.sd.all():  # its quantiles have no density
        return math.inf
    ends = _find_intervals(tip)[1][max(INTERVAL_PROBABILITIES)]  # (2, planes)
    away = (ends - tip.means[:, None]) / tip.sd  # (B, 2, planes)
    density = np.exp(-0.5 * away**2).mean(axis=0) / (math.sqrt(2 * math.pi) * tip.sd)
    errors = scipy.special.ndtr(away).std(axis=0) / math.sqrt(len(away)) / density
    return float((errors / np.ptp(ends, axis=0)).max())


def _score_prediction(mixture: PredictiveMixture, measured: Floats, shape_pit: float) -> Row:
    """Return what became of the prediction of points (K,), the last of them the tip."""
    tip = PredictiveMixture(mixture.means[:, -1:], mixture.sd[-1:])
    at, score, pit = float(measured[-1]), crps(mixture, measured), cdf(mixture, measured)
    median, intervals = _find_intervals(tip)
    row: Row = {"tip_measured_mm": at, "tip_median_mm": float(median[0])}
    row |= {"tip_pit": float(pit[-1]), "tip_crps_mm": float(score[-1])}
    row |= {"shape_crps_mm": float(score.mean()), "shape_pit": shape_pit}
    for level, ends in intervals.items():
        name, (low, high) = f"{100 * level:.0f}", ends[:, 0].tolist()
        row |= {f"tip_{name}_low_mm": low, f"tip_{name}_high_mm": high}
        row |= {f"tip_in_{name}": low <= at <= high}
        row |= {f"shape_in_{name}": shape_pit <= level}
    # width, and what lies outside at 2 / (1 - level) of it: T. Gneiting, A. E. Raftery, JASA 102 (2007) 359
    beyond = max(low - at, at - high, 0.0)
    return row | {"tip_interval_score_mm": high - low + 2 / (1 - level) * beyond}
