"""Predict held-out needles: the predictive distribution of each, compared with its measurement.

A draw of the parameters gives one needle, through the layers that its own planned path meets, with a bevel
offset of its own (given what was measured of the same insertion at other depths, where there is any) and
depths of layers and insertion drawn as the dataset states their errors; about it stand
the errors of pose and points. In a specimen that was not tuned on the parameters differ too
(`NewSpecimens`). The measured shape enters nowhere but as what is compared (and laid on, where its pose is
free). What the model misses is not predicted: where coverage falls short of its level, that is why, or the
stated errors are too small. A needle is one trial: its tip, and its shape as a whole, which holds if no point
of it leaves a band that the predicted probability of such needles stays within all along.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers, find_repeats, list_bevels
from needlefit.inference import specimens
from needlefit.inference.compared_points import align
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.identifiability.precision import add_estimated_noise
from needlefit.inference.likelihood.observation import Observation, make_observation
from needlefit.inference.optimize import minimize
from needlefit.inference.predict import (
    INTERVAL_PROBABILITIES,
    Draws,
    PredictiveMixture,
    cdf,
    crps,
    quantile,
    rms_noise_scale,
    simulate_shape_pit,
    thin_posterior,
)
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import WeightedDraws, resample_draws, sample_about_fit
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample_from_fit
from needlefit.project.progress import never_stop
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, TaskPool, TaskStop, run_parts
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.studies.coverage import estimate_width_after_one
from needlefit.studies.job import Fold, Job, Settings
from needlefit.studies.planned_draws import (
    PlannedNeedles,
    draw_conditions,
    scale_bevels,
    simulate_planned,
    vary_bevels,
)
from needlefit.studies.score import Row

PREDICTION_DRAWS = 1000  #: parameter sets of which a needle is predicted


@dataclass(frozen=True)
class PosteriorFit:
    """A fit and draws of its posterior; Pareto's k of the weights, NaN where nothing is free, and whether it
    was sampled.
    """

    fit: Fit
    draws: Draws
    k: float
    sampled: bool = False


def fit_posterior(
    job: Job, problem: Problem, key: tuple[str, ...], settings: Settings, draws: int = PREDICTION_DRAWS
) -> PosteriorFit:
    """Fit the free parameters of a problem, and draw from their posterior, by the recipe of the job.

    Raises FitError if the search finds no point that can be solved.

    `job`: for its recipe, seed and name. `problem`: of the job's kind; other insertions or priors than its
    folds' are welcome. `key`: what this is, among all that is learned in the job: it keys the random streams.
    `settings`: for `jobs` and `stop`; after a stop the answer means nothing. `draws`: how many; their
    `faults` say so if they are not certified, nor the sampler converged.
    """
    fit = find_fit(job, problem, key, settings)
    if not len(fit.theta) or settings.stop():
        return PosteriorFit(fit, Draws(np.empty((draws, len(fit.theta))), "importance"), float("nan"))
    rng = random_stream(job.recipe.seed, job.name, *key, "weighed")
    found, posterior = weigh_or_sample(job, problem, fit, rng, key, settings)
    if found.certified:
        return PosteriorFit(fit, resample_draws(found, draws, rng), found.k)
    nothing = Draws(np.empty((0, len(fit.theta))), "posterior")
    drawn = nothing if posterior is None else thin_posterior(posterior, problem.parameters, draws, found.k)
    return PosteriorFit(fit, drawn, found.k, sampled=True)


def weigh_or_sample(
    job: Job, problem: Problem, fit: Fit, rng: np.random.Generator, key: tuple[str, ...], settings: Settings
) -> tuple[WeightedDraws, Posterior | None]:
    """Return weighted draws about a fit, and where they are not certified the posterior by MCMC.

    That is None too after a stop before there is any.
    """
    found = sample_about_fit(problem, fit, rng, settings.jobs, pool=settings.part_pool)
    if found.certified or settings.stop():
        return found, None
    return found, sample_posterior(job, problem, fit, key, settings)


def find_fit(job: Job, problem: Problem, key: tuple[str, ...], settings: Settings) -> Fit:
    """Return the fit alone, by the recipe of the job; arguments and errors as of `fit_posterior`."""
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs, pool=settings.part_pool)
    return minimize(problem, job.recipe, random_stream(job.recipe.seed, job.name, *key, "starts"), callbacks)


def sample_posterior(
    job: Job, problem: Problem, fit: Fit, key: tuple[str, ...], settings: Settings
) -> Posterior | None:
    """Return the posterior by MCMC from all equally good starts; None after a stop before there is any."""
    known = add_estimated_noise(problem, np.array(fit.theta))
    rng = random_stream(job.recipe.seed, *key, "posterior")
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    return sample_from_fit(known, fit, job.recipe.sample, rng, callbacks)


#: insertions of a specimen that its estimate uses, the deepest and others evenly over depths
MAX_INSERTIONS = 4


@dataclass
class NewSpecimens:
    """The spreads that predictions of a fold use; they and the estimates of specimens are kept."""

    job: Job
    fold: Fold
    theta: Floats  #: (P,) the fit, from which the estimates are searched
    estimates: dict[str, specimens.SpecimenEstimate | None] = field(default_factory=dict)
    spreads: dict[tuple[str, ...], specimens.SpecimenSpread] = field(default_factory=dict)

    def differs(self, insertion: Insertion) -> bool:
        """Return whether an insertion goes into a specimen that was not tuned on, and may differ."""
        return self.job.record.specimens == "others" and insertion.specimen not in self._tuned

    def learn_spreads(self, insertions: Sequence[Insertion], jobs: int, pool: TaskPool) -> None:
        """Learn the spreads for some insertions; the specimens are fitted side by side."""
        moving = insertions if specimens.list_groups(self.job.parameters) else ()
        others = {name for insertion in moving for name in self.list_others(insertion)}
        wanted = sorted(others - self.estimates.keys())
        found = dict(run_parts(self._search, wanted, pool, jobs, TaskStop(never_stop)))
        self.estimates |= {specimen: found[n] for n, specimen in enumerate(wanted)}
        for insertion in insertions:
            self.find_spread(insertion)

    def find_spread(self, insertion: Insertion | None) -> specimens.SpecimenSpread:
        """Return the spread between specimens, learned without that of this insertion.

        None stands for one into a specimen that is not in the dataset.
        """
        stated = self.job.recipe.specimens
        prior = (float(np.log(stated.modulus_factor)), float(np.log(stated.bevel_factor)))
        moving = specimens.list_groups(self.job.parameters)
        others = tuple(self.list_others(insertion)) if moving else ()
        if others not in self.spreads:
            self.estimates |= {one: self._search(one) for one in others if one not in self.estimates}
            found = [one for name in others if (one := self.estimates[name]) is not None]
            self.spreads[others] = specimens.learn_spread(found, self.job.parameters, prior)
        return self.spreads[others]

    def move(self, thetas: Floats, insertion: Insertion | None, rng: np.random.Generator) -> Floats:
        """Return draws (B, P) of the parameters in the specimen of an insertion."""
        spread = self.find_spread(insertion)
        return specimens.move_to_new_specimen(self.job.parameters, thetas, spread, len(self._tuned), rng)

    @property
    def _tuned(self) -> set[str]:
        return {one.specimen for one in self.fold.tune}

    def list_others(self, insertion: Insertion | None) -> list[str]:
        """Return the other specimens with as many layer boundaries, by default as those tuned on."""
        counts = {len(one.surfaces) for one in (self.fold.tune if insertion is None else (insertion,))}
        alike = [one for one in self.job.dataset.insertions if len(one.surfaces) in counts]
        deepest = [one for one in alike if max(one.sequence) <= self.job.medium.layers]
        target = set() if insertion is None else {insertion.specimen}
        return sorted({one.specimen for one in deepest} - target)

    def _search(self, specimen: str) -> specimens.SpecimenEstimate | None:
        fits = [one for one in self.job.dataset.insertions if max(one.sequence) <= self.job.medium.layers]
        own = sorted((one for one in fits if one.specimen == specimen), key=lambda one: (one.depth, one.id))
        chosen = np.unique(np.linspace(0, len(own) - 1, MAX_INSERTIONS).round().astype(int))
        everything = self.job.problem(self.fold)
        return specimens.estimate_specimen(
            replace(everything, insertions=tuple(own[k] for k in chosen)), self.theta
        )


def describe_specimen(new: NewSpecimens | None, insertion: Insertion | None, otherwise: str = "same") -> Row:
    """Return what a prediction knows of its specimen; `otherwise` is what it is called without `new`."""
    mu, b, count, treatment = np.nan, np.nan, np.nan, otherwise
    if new is not None:
        spread = new.find_spread(insertion)
        (mu, b), count, treatment = spread.rms.tolist(), float(spread.specimens), "others"
    return {
        "specimen_treatment": treatment,
        "between_sd_ln_mu": mu,
        "between_sd_ln_b": b,
        "other_specimens": count,
    }


def describe_spread(row: Row) -> str:
    """Return in words by how much a specimen differs, from a row of `describe_specimen`."""
    mu, b = (math.exp(row[f"between_sd_ln_{name}"]) for name in ("mu", "b"))
    count = int(row["other_specimens"])
    return (
        f"its moduli differ by a factor of {mu:.2g} and its bevel parameter by {b:.2g} (one standard "
        f"deviation), learned from {count} specimen{'' if count == 1 else 's'} and the prior that the recipe "
        "states"
    )


FIGURE_DRAWS = 400  #: parameter sets that a figure of the posterior shows
MIN_SOLVED_DRAWS = 10  #: fewer solved draws make no distribution
#: expected width of the 95 % interval of the tip after one measured insertion into the new specimen
AFTER_ONE_COLUMN = "tip_95_width_after_one_mm"
#: columns: `tip_pit` is the probability predicted of a tip up to the measured one, `shape_pit` of a shape
#: nearer, at its worst point, than the measured one; `shape_in_*` says whether that is within 50 or 95 %;
#: `points_in_*` is the part of points within their own interval, which are no independent trials
PREDICTIVE_COLUMNS = (
    "fold", "insertion", "specimen", "medium", "layers", "depth_mm", "specimen_treatment", "between_sd_ln_mu",
    "between_sd_ln_b", "other_specimens", AFTER_ONE_COLUMN, "draw_source", "certified", "draws",
    "failed_solves", "tip_measured_mm", "tip_median_mm", "tip_50_low_mm", "tip_50_high_mm", "tip_95_low_mm",
    "tip_95_high_mm", "tip_pit", "tip_in_50", "tip_in_95", "tip_crps_mm", "tip_interval_score_mm",
    "shape_pit", "shape_in_50", "shape_in_95", "points_in_50", "points_in_95", "shape_crps_mm",
)  # fmt: skip


def draw_fold_parameters(
    job: Job, fold: Fold, fit: Fit, posterior: Posterior | None, settings: Settings
) -> tuple[Draws, Draws]:
    """Draw parameters of a fold: `PREDICTION_DRAWS` to predict with, and `FIGURE_DRAWS` for figures.

    They come from the sampled posterior where there is one, else from importance sampling about the fit, with
    more effort where its weights cannot be trusted, and then from the sampler.
    """
    counts = (PREDICTION_DRAWS, FIGURE_DRAWS)
    if posterior is None and not len(fit.theta):
        few, many = (Draws(np.empty((count, 0)), "importance") for count in counts)
        return few, many
    pareto_k = math.nan
    if posterior is None:
        key = (fold.name, "draws")
        # not keyed by the job's name: the same fit has the same draws, whichever command runs it
        rng = random_stream(job.recipe.seed, *key)
        found, posterior = weigh_or_sample(job, job.problem(fold), fit, rng, key, settings)
        pareto_k = found.k
    if posterior is not None:
        few, many = (thin_posterior(posterior, job.parameters, count, pareto_k) for count in counts)
        return few, many
    # both sets come from one generator: their order is part of the result
    few, many = (resample_draws(found, count, rng) for count in counts)
    return few, many


BAND_COLUMNS = (
    *("fold", "insertion", "x_mm", "measured_mm", "median_mm"),
    *("low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
)  #: columns: where a held-out needle was predicted to be measured, point by point, at its measured x

BAND_POINTS = 41  #: points of a band that are kept, of up to some 200


@dataclass(frozen=True)
class HeldOutPrediction:
    """The prediction of one needle: its row of `PREDICTIVE_COLUMNS`, and its rows of `BAND_COLUMNS`.

    `solved` needles were simulated, one a draw, `outside` of them outside what the model assumes.
    """

    row: Row
    band: tuple[Row, ...]
    solved: int
    outside: int


def tabulate_held_out(job: Job, fold: Fold, draws: Draws, new: NewSpecimens | None = None) -> Iterator[Row]:
    """Yield one row for every insertion that a fold holds out, y toward +y of C, mm."""
    return (one.row for one in predict_held_out(job, fold, draws, new))


def predict_held_out(
    job: Job,
    fold: Fold,
    draws: Draws,
    new: NewSpecimens | None = None,
    jobs: int = 1,
    pool: TaskPool = THIS_PROCESS,
    *,
    bands: bool = False,
) -> Iterator[HeldOutPrediction]:
    """Yield the prediction of every insertion that a fold holds out, y toward +y of C, mm.

    Of an insertion whose points have no stated noise, nothing: its measurement then has no distribution.
    With `new`, parameters differ in specimens that were not tuned on. Without `bands`, those are left out,
    and what one measured insertion into a new specimen would leave of the width.
    """
    given = [one for one in fold.validate if job.dataset.noise.stated or one.sd is not None]
    if new is not None:
        new.learn_spreads(tuple(filter(new.differs, given)), jobs, pool)  # before several tasks want them
    side_by_side = max(1, min(jobs, len(given)))
    # what is predicted are the stored points, as they will be measured
    update = {"depths": "fixed", "bevel_spread": 0.0, "measurement": "points"}
    predict = _Predictor(
        job,
        fold,
        draws,
        new,
        job.recipe.likelihood.model_copy(update=update),
        rms_noise_scale(draws, job.parameters, job.recipe.likelihood.noise_scale),
        find_repeats(job.dataset),
        job.problem(fold) if fold.tune else None,
        jobs // side_by_side,
        bands,
        _choose_representatives(job, filter(new.differs, given))
        if new is not None and bands
        else frozenset(),
    )
    parts = run_parts(predict.predict, given, pool, side_by_side, TaskStop(never_stop))
    found = dict(parts)
    yield from filter(None, (found[n] for n in range(len(given))))


@dataclass(frozen=True)
class _Predictor:
    """Predicts insertions that a fold holds out, each on `jobs` threads."""

    job: Job
    fold: Fold
    draws: Draws
    new: NewSpecimens | None
    likelihood: LikelihoodRecord
    factor: float
    repeats: Mapping[str, tuple[str, int]]
    tuned_on: Problem | None
    jobs: int
    bands: bool
    representatives: frozenset[str]

    def predict(self, insertion: Insertion) -> HeldOutPrediction | None:
        """Return the prediction of an insertion; None where too few draws have a solution."""
        job, fold, draws, new = self.job, self.fold, self.draws, self.new
        rng = random_stream(job.recipe.seed, job.name, fold.name, "foretold", insertion.id)
        observation = make_observation(job.dataset, insertion, likelihood=self.likelihood)
        tuned = any(insertion.specimen == one.specimen for one in fold.tune)
        differing = new if new is not None and new.differs(insertion) else None
        about = describe_specimen(differing, insertion, "same" if tuned else "training only")
        # the depths of one insertion have one specimen and one bevel
        own = self.repeats.get(insertion.id)
        once = rng if own is None else random_stream(job.recipe.seed, job.name, fold.name, "foretold", *own)
        thetas = draws.thetas if differing is None else differing.move(draws.thetas, insertion, once)
        sets = [job.parameters.values(theta) for theta in thetas]
        deviations = once.standard_normal(len(sets))
        if self.tuned_on is not None and len(sets):
            deviations = _condition_bevels(self.tuned_on, sets, own, deviations, self.jobs)
        found = self._simulate(insertion, observation, scale_bevels(sets, deviations), rng)
        solved = found.solved
        if np.sum(solved) < MIN_SOLVED_DRAWS:
            return None
        heights = align(observation.pose, found.points[solved], observation.measured)[..., 1]
        covariance, measured = _measurement_covariance(observation, self.factor), observation.measured[:, 1]
        mixture = PredictiveMixture(heights, np.sqrt(np.diag(covariance)))
        row = {"fold": fold.name, **_describe_insertion(job, insertion, draws, int(np.sum(~solved))), **about}
        row[AFTER_ONE_COLUMN] = math.nan
        if insertion.id in self.representatives:
            some = [values for values, kept in zip(sets, solved, strict=True) if kept]
            row[AFTER_ONE_COLUMN] = self._estimate_after_one(insertion, observation, some, mixture)
        row |= _score_prediction(mixture, measured, simulate_shape_pit(mixture, covariance, measured, rng))
        where = {"fold": fold.name, "insertion": insertion.id}
        points = _band_rows(mixture, observation.measured) if self.bands else ()
        band = ({**where, **point} for point in points)
        return HeldOutPrediction(
            {name: row[name] for name in PREDICTIVE_COLUMNS},
            tuple(band),
            len(heights),
            int(np.sum(~found.valid[solved])),
        )

    def _simulate(
        self,
        insertion: Insertion,
        observation: Observation,
        sets: Sequence[Mapping[str, float]],
        rng: np.random.Generator,
    ) -> PlannedNeedles:
        """Return the needles of sets of values at the observed points, each with depths of its own."""
        conditions, s = draw_conditions(insertion, len(sets), rng), observation.nodes.s[0]
        medium, needle = self.job.medium, self.job.dataset.needle
        return simulate_planned(sets, medium, needle, insertion, s, conditions, self.jobs)

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
        job, fold = self.job, self.fold
        # a stream of its own: no other number depends on it
        rng = random_stream(job.recipe.seed, job.name, fold.name, "after one", insertion.id)
        new_bevel_sd = 1.0 if self.tuned_on is None else self.tuned_on.new_bevel_sd
        found = self._simulate(insertion, observation, vary_bevels(sets, new_bevel_sd, rng), rng)
        again = np.full(len(sets), np.nan)
        aligned = align(observation.pose, found.points[found.solved], observation.measured)
        again[found.solved] = aligned[:, -1, 1]
        errors = first.sd[-1] * rng.standard_normal((2, len(sets)))
        return estimate_width_after_one(again + errors[0], first.means[:, -1] + errors[1])


def _choose_representatives(job: Job, insertions: Iterable[Insertion]) -> frozenset[str]:
    """Return the insertion of median depth of each medium and number of layers, by its id."""
    groups: dict[tuple[str, int], list[Insertion]] = {}
    for one in insertions:
        groups.setdefault((one.medium, count_layers(one, job.record.layer_count_rule)), []).append(one)
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
    """Return the covariance (K, K) of the measured y about a given needle: of points, and of a known pose.

    A free shape or tip track is laid on the measured one, which takes from its errors what a motion can.
    """
    covariance = observation.covariance(factor)
    if observation.pose == "known":
        return covariance
    moved_by: Floats = np.linalg.qr(observation.free)[0]  # (K, 2): across, turn
    left = np.eye(len(moved_by)) - moved_by @ moved_by.T
    aligned: Floats = left @ covariance @ left
    return aligned


def _describe_insertion(job: Job, insertion: Insertion, draws: Draws, failed: int) -> Row:
    return {
        "insertion": insertion.id,
        "specimen": insertion.specimen,
        "medium": insertion.medium,
        "layers": count_layers(insertion, job.record.layer_count_rule),
        "depth_mm": insertion.depth,
        "draw_source": draws.source,
        "certified": not draws.faults,
        "draws": len(draws.thetas),
        "failed_solves": failed,
    }


def _band_rows(mixture: PredictiveMixture, measured: Floats) -> Iterator[Row]:
    """Yield median and intervals at some of the measured points (K, 2), the tip the last."""
    kept = np.unique(np.linspace(0, len(measured) - 1, BAND_POINTS).round().astype(np.int64))
    some = PredictiveMixture(mixture.means[:, kept], mixture.sd[kept])
    median, intervals = _find_intervals(some)
    columns = {"x_mm": measured[kept, 0], "measured_mm": measured[kept, 1], "median_mm": median}
    for level, (low, high) in intervals.items():
        columns |= {f"low_{100 * level:.0f}_mm": low, f"high_{100 * level:.0f}_mm": high}
    for k in range(len(kept)):
        yield {name: float(values[k]) for name, values in columns.items()}


def _find_intervals(mixture: PredictiveMixture) -> tuple[Floats, dict[float, Floats]]:
    """Return the median (K,), and by level the ends (2, K) of the intervals: one search finds them all."""
    ends = [(1 + side * level) / 2 for level in INTERVAL_PROBABILITIES for side in (-1, 1)]
    median, *found = quantile(mixture, (0.5, *ends))
    pairs = np.array(found).reshape(len(INTERVAL_PROBABILITIES), 2, -1)
    return median, dict(zip(INTERVAL_PROBABILITIES, pairs, strict=True))


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
        row |= {f"points_in_{name}": float(np.mean(np.abs(pit - 0.5) <= level / 2))}
    # width, and what lies outside at 2 / (1 - level) of it: T. Gneiting, A. E. Raftery, JASA 102 (2007) 359
    beyond = max(low - at, at - high, 0.0)
    return row | {"tip_interval_score_mm": high - low + 2 / (1 - level) * beyond}
