"""Draw the parameters of a fold: in the specimens that were tuned on, and in a further one."""

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.folds import Fold, divide_insertions
from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError
from needlefit.inference import specimens
from needlefit.inference.draws import Draws, thin_posterior
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.identifiability.information import add_estimated_noise
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.optimize import minimize
from needlefit.inference.prior_shift import PriorShift, draw_held, measure_shifts
from needlefit.inference.problem import Problem, find_new_bevel_sd
from needlefit.inference.sampling.importance import (
    LARGER_EFFORT,
    Effort,
    LogDensityFunction,
    WeightedDraws,
    resample_draws,
    sample_about_fit,
    sample_about_modes,
)
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.sample import sample, sample_density
from needlefit.project.callbacks import Step, no_step
from needlefit.project.checkpoint import Checkpoint
from needlefit.project.tasks import run_parts
from needlefit.project.toml import describe_key
from needlefit.reporting.table_files import Row
from needlefit.studies.job import Job, Settings
from needlefit.studies.run import NEW_SPECIMEN

PREDICTION_DRAWS = 1000  #: number of parameter sets of which a needle is predicted
FIGURE_DRAWS = 400  #: number of parameter sets that a figure of the posterior shows
#: number of parameter sets at which the effect of the fixed parameters on the needles is computed
SHIFT_DRAWS = 5
#: efforts of sampling of one specimen by itself: where its posterior overlaps with the others', few of its
#: draws lie
SPECIMEN_EFFORTS = (Effort(draws=500, min_ess=1000.0), LARGER_EFFORT)


def search_fit(
    job: Job,
    fold: Fold,
    search: str,
    settings: Settings,
    checkpoint: Checkpoint,
    step: Step = no_step,
) -> Fit:
    """Return the fit of one search of a fold, which is kept once it has ended.

    Raises FitError if the search finds no point that can be solved.
    """
    key = "/".join([fold.name, search, *job.parameters.held, *["again"] * (job.response_at is not None)])
    if kept := checkpoint.read(key, Fit):
        return kept
    step(0, 1)
    rng = job.random(fold.name, search, "starts")
    callbacks = Callbacks(settings.stop, step, settings.jobs)
    fit = minimize(job.problem(fold, search), job.recipe_of(search), rng, callbacks)
    if not fit.interrupted:
        checkpoint.keep(key, fit)
    return fit


def sample_posterior(
    job: Job,
    problem: Problem,
    fit: Fit,
    begin: WeightedDraws,
    key: tuple[str, ...],
    settings: Settings,
    step: Step = no_step,
) -> Posterior | None:
    """Return the posterior by MCMC, from weighted draws about a fit; None after a stop before there is any.

    `step` is called with the number of steps made, and of all.
    """
    noisy = add_estimated_noise(problem.holding(fit.held), np.array(fit.theta))
    rng = job.random(*key, "posterior")
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs)
    return sample(noisy, begin, job.recipe.sample, rng, callbacks)


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
    step: Step = no_step,
) -> FoldDraws:
    """Draw parameters of a fold by importance sampling about its fit.

    Where the settings ask for it, or the weights are not certified, an ensemble of walkers goes on from these
    draws. Its draws are used if it has converged, or those by importance are not certified. `step` is the
    ensemble's.
    """
    counts = (PREDICTION_DRAWS, FIGURE_DRAWS)
    # no job's name is in it: the same fit has the same draws, whichever command runs it
    key, problem = (fold.name, "draws"), job.problem(fold)
    rng = job.random(*key)
    if not problem.holding(fit.held).searched.names:
        priors = (draw_held(job.parameters, np.empty((count, 0)), rng) for count in counts)
        few, many = (Draws(thetas, "importance", mode=np.array(fit.theta)) for thetas in priors)
        return FoldDraws(few, many)
    draws = sample_about_fit(problem, fit, rng, settings.jobs)
    # both sets come from one generator: their order is part of the result
    few, many = (resample_draws(draws, count, rng) for count in counts)
    posterior = None
    if (settings.sample or not draws.certified) and not settings.stop():
        posterior = sample_posterior(job, problem, fit, draws, key, settings, step)
    if posterior is not None and not (posterior.faults and draws.certified):
        few, many = (thin_posterior(posterior, job.parameters, count, draws.k) for count in counts)
    return FoldDraws(replace(few, mode=np.array(fit.theta)), many, posterior)


def measure_prior(job: Job, fold: Fold, thetas: Floats) -> dict[str, PriorShift]:
    """Return how far the prior of each parameter that is held moves the needles, at some thetas (B, P)."""
    if not (len(thetas) and job.parameters.held):
        return {}
    few = np.unique(np.linspace(0, len(thetas) - 1, SHIFT_DRAWS).round().astype(np.int64))
    return measure_shifts(job.problem(fold), thetas[few])


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
    callbacks: Callbacks | None = None  #: of an ensemble that samples the population; None: by importance
    #: draws of the posterior of each specimen by itself, by its insertions; folds may share them
    posteriors: dict[tuple[str, ...], Draws] = field(default_factory=dict)
    sets: dict[bytes, list[dict[str, float]]] = field(default_factory=dict)  #: by the thetas they are of

    @cached_property
    def tuned(self) -> dict[str, tuple[Insertion, ...]]:
        return divide_insertions(self.fold.tune, "specimen")

    @cached_property
    def model(self) -> specimens.SpreadModel:
        """Which parameters differ between specimens, and the prior of their spread."""
        problem, near = self.job.problem(self.fold).searched, self.draws.thetas
        if near.size:
            theta = self.job.parameters.restrict(near.mean(axis=0))
        else:
            theta = minimize_squares(problem, problem.parameters.expected).theta
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
            wanted = {name: tuple(insertion.id for insertion in group) for name, group in self.tuned.items()}
            missing = [name for name, ids in wanted.items() if ids not in self.posteriors]
            sampled = dict(run_parts(self._sample_specimen, missing, self.jobs))
            self.posteriors |= {wanted[name]: sampled[n] for n, name in enumerate(missing)}
            by_specimen = {name: self.posteriors[ids] for name, ids in wanted.items()}
            posteriors = {name: posterior.thetas for name, posterior in by_specimen.items()}
            faults = [
                f"specimen {name}: {fault}"
                for name, posterior in by_specimen.items()
                for fault in posterior.faults
            ]
        rng = self.job.random(self.fold.name, "specimens", count)
        if faults:
            nothing = np.empty((0, len(self.job.parameters.free)))
            empty = np.empty((0, len(self.model.names), len(self.model.names)))
            return specimens.PopulationDraws({}, nothing, nothing, empty, tuple(faults))
        sampler = None if self.callbacks is None else self._sample_population
        return specimens.draw_population(self.job.parameters, self.model, posteriors, count, rng, sampler)

    def _sample_population(
        self, log_density: LogDensityFunction, names: tuple[str, ...], begin: WeightedDraws
    ) -> Posterior | None:
        """Return the population by an ensemble of walkers that goes on from weighted draws."""
        rng = self.job.random(self.fold.name, "specimens", "ensemble")
        assert self.callbacks is not None
        return sample_density(log_density, names, begin, self.job.recipe.sample, rng, self.callbacks)

    def tabulate_population(self) -> list[Row]:
        """Return how much each parameter differs between several specimens; nothing if that is uncertain."""
        population = self.population
        if population.faults:
            return []
        correlation = population.correlation if self.model.correlated else np.nan
        about = {"between_correlation": correlation, "other_specimens": len(self.tuned)}
        return [
            {"fold": self.fold.name, "parameter": name, "between_sd": sd, **about}
            for name, sd in zip(self.model.names, population.rms.tolist(), strict=True)
        ]

    def draws_in(self, insertion: Insertion | None) -> Draws:
        """Return draws in the specimen of an insertion; of None in one that is not in the dataset."""
        if insertion is None or self.differs(insertion):
            return self._describe(self.population.new)
        tuned = self.population.tuned.get(insertion.specimen) if self.separate else None
        return self.draws if tuned is None else self._describe(tuned)

    def list_sets(self, draws: Draws) -> list[dict[str, float]]:
        """Return the values of the parameters of draws, once for all insertions that share these."""
        key = draws.thetas.tobytes()
        if key not in self.sets:
            self.sets[key] = [self.job.parameters.values(theta) for theta in draws.thetas]
        return self.sets[key]

    def mode_in(self, insertion: Insertion | None) -> Floats | None:
        """Return theta (P,) of the posterior mode: in the specimen of an insertion, in a new one of all."""
        if insertion is None or not self.separate or insertion.specimen not in self.population.tuned:
            return self.draws.mode
        return self.posteriors[tuple(tuned.id for tuned in self.tuned[insertion.specimen])].mode

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
        population = self.population
        mode = self.draws.mode
        return Draws(
            thetas,
            population.source,
            population.faults,
            population.pareto_k,
            population.effective_sample_size,
            mode,
        )

    def describe(self, insertion: Insertion) -> Row:
        """Return what is known of the specimen of an insertion, with the spread of a new one."""
        mu, b, correlation, count = (np.nan,) * 4
        treatment = "same" if insertion.specimen in self.tuned else "training only"
        if self.differs(insertion):
            model, sds, treatment = self.model, self.population.rms, "others"
            count = float(len(self.tuned) if self.separate else 0)
            mu = float(sds[0]) if model.moduli else 0.0
            b = float(sds[model.moduli]) if len(sds) > model.moduli else 0.0
            correlation = self.population.correlation if self.separate and model.correlated else np.nan
        return {
            "specimen_treatment": treatment,
            "between_sd_ln_mu": mu,
            "between_sd_ln_b": b,
            "between_correlation": correlation,
            "other_specimens": count,
        }

    def list_draws(self, thetas: Floats) -> dict[str, Floats]:
        """Return as many draws (B, P) in each specimen that has some of its own, and in a `NEW_SPECIMEN`.

        `thetas` (B, P) are draws of all insertions together, about which a single specimen's lie.
        """
        about = replace(self.draws, thetas=thetas)
        population = self.population if self.separate else replace(self, draws=about).population
        tuned = population.tuned if self.separate else {}
        return {name: some[: len(thetas)] for name, some in {**tuned, NEW_SPECIMEN: population.new}.items()}

    def problem_of(self, insertion: Insertion | None) -> Problem:
        """Return the problem whose bevels an insertion's is one of: of its specimen, or of all tuned on."""
        everything = self.job.problem(self.fold)
        tuned = self.tuned.get(insertion.specimen) if insertion is not None and self.separate else None
        return everything if tuned is None else replace(everything, insertions=tuned)

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
        searched = problem.searched
        begin, easier = searched.parameters.expected, searched.plain
        near = begin if easier is None else minimize_squares(easier, begin).theta
        minimum = minimize_squares(searched, near)
        rng = job.random(*key)
        if minimum.converged:
            noisy = add_estimated_noise(problem, job.parameters.extend(minimum.theta))
            modes = [minimize_squares(noisy.searched, minimum.theta)]
            draws = sample_about_modes(noisy, modes, rng, efforts=SPECIMEN_EFFORTS)
            if draws.certified:
                mode = job.parameters.extend(minimum.theta)
                return replace(resample_draws(draws, PREDICTION_DRAWS, rng), mode=mode)
        rng = job.random(job.name, *key, "starts")
        fit = minimize(problem, job.recipe, rng)
        rng, mode = job.random(job.name, *key, "weighed"), np.array(fit.theta)
        draws = sample_about_fit(problem, fit, rng)
        if draws.certified:
            return replace(resample_draws(draws, PREDICTION_DRAWS, rng), mode=mode)
        posterior = sample_posterior(job, problem, fit, draws, key, Settings())
        if posterior is None:
            return Draws(np.empty((0, len(mode))), "posterior", mode=mode)
        return replace(thin_posterior(posterior, job.parameters, PREDICTION_DRAWS, draws.k), mode=mode)


def choose_specimen(specimens: Specimens, into: str) -> Insertion | None:
    """Return an insertion tuned on in the specimen named `into`; None for a "new" one.

    Where specimens do not differ, other words are any of those tuned on.

    Raises ConfigError if specimens differ, and `into` names none of them.
    """
    if into == "new":
        return None
    if into not in specimens.tuned and (specimens.separate or into not in ("same", "training only")):
        words = "each has parameters of its own" if specimens.separate else f"{into!r} is none of them"
        raise ConfigError(
            f"the specimens tuned on are {', '.join(specimens.tuned)}: {words}",
            where=describe_key(specimens.job.name, "specimen"),
            key="specimen",
            expected=f"new, or one of {', '.join(specimens.tuned)}",
        )
    return specimens.tuned.get(into, specimens.fold.tune)[0]
