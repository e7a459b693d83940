"""Fit, sample, predict and validate from Python; each returns a `Run`, as the commands write it.

Inputs are names (of what ships, or lies in the working folder), paths, or records, tables and datasets in
memory. Nothing is written but by `Run.save`, `write_prior`, and with `checkpoint`.
"""

import math
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.folds import divide_insertions
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.inference.ecdf_band import ecdf_band as ecdf_band
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.parameter_changes import change_fit, read_priors, set_priors
from needlefit.inference.predict import Draws, thin_posterior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling import sample as ensemble
from needlefit.inference.sampling.importance import (
    MAX_PARETO_K,
    WeightedDraws,
    leave_out_parts,
    resample_draws,
    sample_about_fit,
)
from needlefit.project.checkpoint import remove_checkpoint
from needlefit.project.cluster import connect_cluster as connect_cluster
from needlefit.project.input_files import is_dir, to_json_values
from needlefit.project.locate import find_file, find_run, find_studies
from needlefit.project.processes import count_cores
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import LocalPool as LocalPool
from needlefit.project.tasks import Progress, Stop, never_stop, no_progress
from needlefit.project.toml import IN_MEMORY, add_file_context, check, dumps, read_given, spell_name
from needlefit.schemas.base import FileRecord
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, SelectionRecord, SyntheticDataRecord
from needlefit.studies import simulated_data
from needlefit.studies.job import Job, Settings, StatedStudy, run_study
from needlefit.studies.judge import REFERENCES as REFERENCES
from needlefit.studies.judge import compare_with_references as compare_with_references
from needlefit.studies.judge import judge_fits as judge_fits
from needlefit.studies.kind import find_kind
from needlefit.studies.load import check_study, load_study, load_study_file, load_target, reopen_fit
from needlefit.studies.run import Run, restore_run
from needlefit.studies.score import make_predictors, make_scorer

Name = str | Path
Table = Mapping[str, Any]
Medium = Name | MediumRecord | Table
Recipe = Name | RecipeRecord | Table

ELPD_DRAWS = 1000  #: of a posterior, by which data that are left out are weighed

#: types of options, and how messages state them
_OPTION_TYPES: Mapping[str, tuple[type, str]] = {
    "name": (str, "a text"),
    "seed": (int, "a whole number"),
    "jobs": (int, "a whole number"),
    "tune": (Mapping, 'a table: {"layers": [3]}'),
    "priors": (Mapping, 'a table: {1: "prior.toml"}'),
    "free": (Sequence, 'a list: ["alpha1"]'),
    "fix": (Mapping, 'a table: {"mu1": 4e3}'),
}


class RunOptions(TypedDict, total=False):
    """How a run goes; `fit` describes each option."""

    name: str | None
    seed: int | None
    jobs: int | None
    progress: bool | Progress
    checkpoint: Name | None


class FitChanges(TypedDict, total=False):
    """What a fit is to differ in from its target; `fit` describes each option."""

    tune: Table | None
    recipe: Recipe | None
    priors: Mapping[int, Name] | None
    free: Sequence[str]
    fix: Mapping[str, float] | None


class FitOptions(FitChanges, RunOptions):
    """The options of `fit` and `sample`."""


def load_dataset(name: Name) -> Dataset:
    """Return the dataset that `name` means: a bare name such as `twin`, a folder, or its `dataset.toml`.

    Raises
    ------
    ConfigError
        If there is none of that name.
    DataError
        Listing every fault of its files.

    Examples
    --------
    >>> dataset = needlefit.load_dataset("twin")
    >>> dataset.origin, len(dataset.insertions)
    ('synthetic', 47)
    """
    return read(find_file("dataset", spell_name(name)))


def load_medium(name: Name) -> dict[str, Any]:
    """Return the keys of a tissue model, to be changed and given as `medium`.

    Lengths are in mm, bounds and fixed values of `parameters` in Pa, mm and degrees.

    Raises
    ------
    ConfigError
        If there is none of that name, or it holds a wrong, missing or unknown key.

    Examples
    --------
    >>> chicken = load_medium("chicken")
    >>> chicken["parameters"]["bevel_mm"]
    {'bounds': [0.001, 0.5]}
    """
    record, _ = read_given("medium", name, MediumRecord)
    return record.model_dump(mode="json", by_alias=True, exclude_none=True)


def simulate_dataset(data: Table, medium: Medium, seed: int) -> Dataset:
    """Return a dataset of simulated insertions into one layer, for `score_study` and `estimate_evidence`.

    It has no files.

    Parameters
    ----------
    data : table
        `title`; the true `values` (Pa, mm); the `needle`, as in a scene; `noise`, as in a dataset;
        optionally `pose_angle_sd_deg` and `depth_sd_mm`; and `insertions`: a list of tables with
        `depth_mm`, `side` (1 or -1) and `base_moved_mm`, how far the base moves across afterwards.
    medium : str, Path, MediumRecord or table
        The tissue model that generates the shapes.
    seed : int
        Of the errors of measurement.

    Raises
    ------
    ConfigError
        If a key is wrong, or an insertion has no solution.
    """
    record = check(_plain(None, data), SyntheticDataRecord, "needlefit.api.simulate_dataset")
    return simulated_data.simulate_dataset(
        "simulated", record, read_given("medium", medium, MediumRecord)[0], seed
    )


def load_run(folder: Name) -> Run:
    """Return the run that `Run.save` or a command wrote to `folder`, or to `reports/<folder>`.

    The folder of a fit holds its data, so that it can be moved before it is predicted with.

    Raises
    ------
    ConfigError, DataError
        If there is none, its files are damaged, or do not agree with the manifest.
    """
    return restore_run(find_run(spell_name(folder)))


def fit(
    target: Name | Dataset | Run,
    medium: Medium | None = None,
    **options: Unpack[FitOptions],
) -> Run:
    """Fit the parameters of a tissue model (mu in Pa, alpha, b in mm) to measured insertions.

    Parameters
    ----------
    target : str, Path, Dataset or Run
        With `medium`: the data. Without: what ships or your file names, a fit (`"phantom1"`) or a study
        (`"study3"`), of which the tuning alone is done; or a run of one, to fit again with changes.
    medium : str, Path, MediumRecord or table, optional
        The model: layers, and which parameters are free.
    tune : table, optional
        The insertions fitted to, by the keys of `[tune]`: `{"layers": [3]}`. By default those of the target;
        of a dataset with several media those into the medium of this name, else all.
    recipe : str, Path, RecipeRecord or table, optional
        How to search and sample; a table changes keys of the recipe `default`: `{"starts": 4}`. By default
        that of the target, else `default`.
    priors : mapping, optional
        By number of the layer: the file that `write_prior` wrote.
    free : sequence of str
        Parameters to search although the model fixes or ties them, or their posterior is their prior:
        `["alpha1"]`, or `["alpha"]` of every layer.
    fix : mapping, optional
        Parameters to hold at a value, in Pa, mm or degrees: `{"mu1": 4e3, "b": 0.1}`.
    name : str, optional
        Of the result; by default made of what is run. It keys the random streams.
    seed : int, optional
        Of all random numbers, in place of the recipe's.
    jobs : int, optional
        Threads; by default as many as there are cores. The numbers do not depend on it.
    progress : bool or callable
        True prints to stderr; a callable is given what is being done, how much is done, and of how much.
    checkpoint : str or Path, optional
        A folder that keeps finished work; the same call goes on from there. It is removed at the end.

    Returns
    -------
    Run
        Of kind `fit`. Ctrl-C ends the search early with the best so far, marked `interrupted`.

    Raises
    ------
    ConfigError, DataError
        If anything that is named is missing or wrong.
    FitError
        If the search finds no point that can be solved.

    Examples
    --------
    >>> run = needlefit.fit("twin", "chicken", tune={"insertions": ["chicken-04"]}, recipe="quick")
    >>> run.kind, run.name, run.interrupted
    ('fit', 'twin-chicken', False)
    """
    return _fit(target, medium, **options)


def sample(
    target: Name | Dataset | Run,
    medium: Medium | None = None,
    **options: Unpack[FitOptions],
) -> Run:
    """Fit as `fit`, then sample the posterior by MCMC, as `needlefit tune` does.

    Parameters
    ----------
    target, medium, tune, recipe, priors, free, fix, name, seed, jobs, progress, checkpoint
        As of `fit`; `target` may also be a run of a study with one fold.

    Returns
    -------
    Run
        With `posterior`, whose `to_xarray()` is for ArviZ. Ctrl-C ends early, marked `interrupted`.

    Raises
    ------
    ConfigError, DataError, FitError
        As `fit`; also if the data that `target` was fitted to are no longer the same.
    """
    return _fit(target, medium, sample=True, **options)


def predict(
    target: Name | Run,
    scene: Name | SceneRecord | Table,
    specimen: str | None = None,
    **options: Unpack[RunOptions],
) -> Run:
    """Predict a planned insertion, with its uncertainty.

    Parameters
    ----------
    target : str, Path or Run
        What was fitted: a fit or a study, or its run. Draws come from the posterior of a run that was
        sampled, else, by importance sampling, from about a fit that is made now.
    scene : str, Path, SceneRecord or table
        The planned insertion; its moduli and bevel offset are replaced. The rules that it states must be
        those of the fit.
    specimen : str, optional
        Where it goes: into a "new" one, whose parameters differ, or the "same" that was tuned on; of several
        that differ, its name.
        By default a new one, whose parameters differ unless `specimens` of the target leaves that out.
    name, seed, jobs, progress, checkpoint
        As of `fit`.

    Returns
    -------
    Run
        Of kind `prediction`; `frames["forecast"]` has the needle and its bands by arc length, mm (NaN where
        the draws are not certified).

    Raises
    ------
    ConfigError, DataError
        If anything that is named is missing or wrong, or the run's data are no longer the same.
    ModelError
        If no draw of the parameters can be solved for this scene.
    KeyboardInterrupt
        With Ctrl-C.
    """
    if not isinstance(specimen, str | None):
        raise ConfigError(f"`specimen` is {specimen!r:.60}", expected='"new", "same", or a name')
    run: Run | None
    if isinstance(target, Run):
        fitted, run = _reopen(target), target
        about, inputs = fitted.name, fitted.inputs
    else:
        about, _, inputs, _, run = load_target(spell_name(target))
    inputs = replace(inputs, judged=run)
    planned, scene_name = read_given("scene", scene, SceneRecord)
    about = about.removesuffix("-tune")
    record = find_kind("prediction").make_record(
        target=about if isinstance(target, Run) else spell_name(target),
        scene=planned,
        scene_name=scene_name,
        posterior=None if inputs.posterior is None else about,
        specimen=specimen,
    )
    stem = Path(scene_name).stem if scene_name != IN_MEMORY else "scene"
    planned_study = StatedStudy(f"predict-{about}-{stem}", record, inputs)
    return _run(planned_study, **options)


def validate(
    study: Name | FileRecord | Table,
    *,
    dataset: Name | Dataset | None = None,
    medium: Medium | None = None,
    recipe: Recipe | None = None,
    **options: Unpack[RunOptions],
) -> Run:
    """Run a study of any kind: fit and score held-out insertions, or whatever else its file asks.

    Parameters
    ----------
    study : str, Path, record or table
        A name such as `study3`, a path, or the keys of a study file.
    dataset : str, Path or Dataset, optional
        Of a study that fits and scores: another dataset, with insertions of the same names, such as
        `make_twin(folder, 2)` of `studies/synthetic`.
    medium : str, Path, MediumRecord or table, optional
        Another tissue model: `load_medium("phantom2") | {"tangent_part": 0.5}`.
    recipe : str, Path, RecipeRecord or table, optional
        How to search and sample, in place of what the study names; a table changes keys of `default`.
    name, seed, jobs, progress, checkpoint
        As of `fit`.

    Raises
    ------
    ConfigError, DataError
        If anything that is named is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    KeyboardInterrupt
        With Ctrl-C.
    """
    changed = _replace_inputs(_load_study(study), dataset, medium, recipe)
    return _run(changed, **options)


def score_study(
    study: Name | FileRecord | Table,
    *,
    dataset: Name | Dataset | None = None,
    medium: Medium | None = None,
    recipe: Recipe | None = None,
    seed: int | None = None,
    jobs: int | None = None,
) -> pd.DataFrame:
    """Fit a study, and return the errors of every method on every insertion.

    Intervals, predictions and the error-minimising fit of `validate` are left out: seconds instead of a
    minute. Layers are where the needle was measured to cross them, as in the paper's tables.

    Parameters
    ----------
    study : str, Path, record or table
        A study that fits and scores, or a fit, as of `validate`.
    dataset, medium, recipe, seed, jobs
        As of `validate`; the dataset may be changed in memory.

    Returns
    -------
    DataFrame
        One row per insertion and method: `fold`, `role` ("tune" or "validate"), `insertion`, `medium`,
        `specimen`, `layers`, `depth_mm`, `method`, `converged`, and a column for each metric, mm or percent,
        and for its noise floor, `floor_<metric>`.

    Raises
    ------
    ConfigError, DataError, FitError
        As of `validate`.
    """
    job, jobs = _prepare(
        _replace_inputs(_load_study(study), dataset, medium, recipe, stored=False), seed, jobs
    )
    scorer, rows = make_scorer(job), []
    for fold in job.folds:
        problem = job.problem(fold)
        fits = {
            search: minimize(
                job.problem(fold, search),
                job.recipe_of(search),
                job.random(fold.name, search, "starts"),
                Callbacks(jobs=jobs),
            )
            for search in job.searches
            if search != "fitted_metric"
        }
        methods = make_predictors(problem, fits, job.hand_tuned)
        for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
            for insertion, (method, curves) in product(insertions, methods.items()):
                place = {"fold": fold.name, "role": role, "method": method}
                rows += scorer.score(place, replace(insertion, surfaces=()), curves)["errors"]
    return pd.DataFrame(rows).drop(columns=["boundaries", "comparison"])


def estimate_elpd(
    run: Run, leave_out: Literal["specimen", "insertion"] = "specimen", *, jobs: int | None = None
) -> pd.DataFrame:
    """Estimate how well a tissue model predicts a specimen or insertion from the others.

    Of the data of each it is the expected log predictive density (elpd, of lengths in mm), as if the model
    had been fitted to the others, by Pareto-smoothed importance sampling of the posterior (PSIS-LOO; A.
    Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413). Where its weights are not reliable the others
    are fitted: the density is the evidence of all, less that of the others. Bevels, depths and poses are
    integrated out. As in `posterior`, all specimens have one set of parameters. The larger sum is the better
    model; the difference of two is uncertain by sqrt(n) times the standard deviation of the n differences.

    Parameters
    ----------
    run : Run
        Sampled, of one fold. Runs to be compared need the same insertions and one likelihood (recipe).
    leave_out : "specimen" or "insertion"
        What is left out together.
    jobs : int, optional
        Threads; by default as many as there are cores.

    Returns
    -------
    DataFrame
        By specimen or insertion: `elpd`, and `pareto_k` of the weights (above 0.7 the estimate is not
        reliable).

    Raises
    ------
    ConfigError, DataError
        If the run has no posterior, or one that has not converged; if there is only one specimen; if no noise
        of the points is stated; if the data are no longer the same.
    """
    if leave_out not in ("specimen", "insertion"):
        raise ConfigError(f"`leave_out` is {leave_out!r:.60}", expected='"specimen" or "insertion"')
    posterior = run.posterior
    if posterior.faults:
        raise ConfigError(
            f"the posterior of `{run.name}` has not converged: {posterior.faults[0]}",
            fix="sample again, with more `densities` in the recipe",
        )
    job, jobs = _prepare(_reopen(run), None, jobs)
    problem = _require_noise(job).problem(job.folds[0])
    groups = divide_insertions(problem.insertions, leave_out)
    if len(groups) < 2:
        raise ConfigError(
            f"there is only one {leave_out}: none can be left out",
            expected='several, or leave_out="insertion"',
        )
    places = {insertion.id: place for place, insertion in enumerate(problem.insertions)}
    parts = [[places[member.id] for member in members] for members in groups.values()]
    draws = thin_posterior(posterior, job.parameters, ELPD_DRAWS)
    elpd, k = leave_out_parts(problem.log_predictive(draws.thetas, parts, jobs))
    if any(k > MAX_PARETO_K):
        whole = _integrate(job, problem, ("elpd",), jobs)
        for n, name in enumerate(groups):
            if k[n] > MAX_PARETO_K:
                kept = tuple(insertion for insertion in problem.insertions if insertion not in groups[name])
                rest = _integrate(job, replace(problem, insertions=kept), ("elpd", name), jobs)
                elpd[n], k[n] = whole.log_evidence - rest.log_evidence, max(whole.k, rest.k)
    return pd.DataFrame({"elpd": elpd, "pareto_k": k}, index=pd.Index(groups, name=leave_out))


def estimate_evidence(
    target: Name | Dataset | Run,
    medium: Medium | None = None,
    *,
    seed: int | None = None,
    jobs: int | None = None,
    **changes: Unpack[FitChanges],
) -> "pd.Series[float]":
    """Return the evidence of a tissue model: the probability density of the data, over all its parameters.

    The log density of insertions B predicted from insertions A is the evidence of both, less that of A. The
    integral is by importance sampling about the modes of the fit. The prior is not normalised: evidences of
    models with other parameters or bounds cannot be compared; `estimate_elpd` compares them.

    Parameters
    ----------
    target, medium, tune, recipe, priors, free, fix, seed, jobs
        As of `fit`; the dataset may have no files. Recipes to be compared need one likelihood.

    Returns
    -------
    Series
        `log_evidence` (of lengths in mm), its Monte Carlo error `se`, Pareto's `k` of the weights (above
        0.7 the estimate is not reliable) and their effective sample size `ess`.

    Raises
    ------
    ConfigError, DataError, FitError
        As of `fit`; ConfigError also if no noise of the points is stated.
    """
    changed = _change_fit(_open_fit(target, medium, stored=False), **changes)
    job, jobs = _prepare(changed, seed, jobs)
    problem = _require_noise(job).problem(job.folds[0])
    results = _integrate(job, problem, ("evidence",), jobs)
    values = (results.log_evidence, results.log_evidence_se, results.k, results.effective_sample_size)
    return pd.Series(values, index=["log_evidence", "se", "k", "ess"])


def make_problem(
    target: Name | Dataset | Run,
    medium: Medium | None = None,
    **changes: Unpack[FitChanges],
) -> Problem:
    """Return the statistical problem of a fit: its density and residuals, and their exact derivatives.

    Parameters
    ----------
    target, medium, tune, recipe, priors, free, fix
        As of `fit`; the dataset may have no files.

    Raises
    ------
    ConfigError, DataError
        As of `fit`.
    """
    changed = _change_fit(_open_fit(target, medium, stored=False), **changes)
    job, _ = _prepare(changed, None, None)
    return job.problem(job.folds[0])


def simulate_from_prior(problem: Problem, seed: int) -> tuple[Floats, Problem]:
    """Draw parameters from the prior, and simulate and measure the insertions of a problem with them.

    Depths, poses and points err as the dataset states, whatever the likelihood neglects. Parameters for
    which a needle has no solution are drawn again.

    Returns
    -------
    theta : (P,) array
        The true parameters.
    Problem
        That of inferring them: the same one, with other measured shapes.

    Raises
    ------
    ConfigError
        If the dataset states no noise.
    FitError
        If there are hardly any parameters with a solution.
    """
    return simulated_data.simulate_from_prior(problem, random_stream(seed, "prior"))


def draw_posterior(
    problem: Problem, count: int, seed: int, *, recipe: Recipe = "default", jobs: int | None = None
) -> Draws:
    """Fit a problem, and draw from its posterior.

    Draws are by importance sampling, and by MCMC from these where their weights are not reliable.

    Parameters
    ----------
    problem : Problem
        As from `make_problem`; its dataset states its noise.
    count : int
        Number of draws.
    seed : int
        Of all random numbers.
    recipe : str, Path, RecipeRecord or table
        How to search and sample; a table changes keys of the recipe `default`.
    jobs : int, optional
        Threads; by default as many as there are cores.

    Returns
    -------
    Draws
        `thetas` (count, P), the `mode` (P,), and `faults`, empty if the draws are reliable.
        `problem.values(theta)` are a draw's values in Pa and mm.

    Raises
    ------
    ConfigError
        If anything that is named is missing or wrong.
    FitError
        If the search finds no point that can be solved.
    """
    _check_types(seed=seed, jobs=jobs)
    chosen, _ = _read_recipe(recipe)
    rng, callbacks = random_stream(seed, "posterior"), Callbacks(jobs=count_cores() if jobs is None else jobs)
    fit = minimize(problem, chosen.model_copy(update={"minimize": "posterior"}), rng, callbacks)
    posterior = sample_about_fit(problem, fit, rng, callbacks.jobs)
    draws = resample_draws(posterior, count, rng)
    if not posterior.certified:
        chains = ensemble.sample(problem.holding(fit.held), posterior, chosen.sample, rng, callbacks)
        assert chains is not None  # nothing stops it
        draws = thin_posterior(chains, problem.parameters, count, posterior.k)
    return replace(draws, mode=np.array(fit.theta))


def write_prior(
    file: Name, mean: Floats, covariance: Floats, foundation: tuple[float, float] | None = None
) -> Path:
    """Write the prior of a layer that fits read, and return its path: `priors = { 1 = "prior.toml" }`.

    Parameters
    ----------
    file : str or Path
        The TOML file.
    mean, covariance : array, (2,) and (2, 2)
        Of ln mu (mu in Pa) and alpha of the tissue, as from compression tests.
    foundation : (float, float), optional
        The model's mu over the shear modulus of the tissue, and the factor within which that is known, at
        one standard deviation. Without it the prior is of alpha alone.

    Raises
    ------
    ConfigError
        If mean or covariance are of another shape, or no covariance.
    """
    try:
        log_mu, alpha = np.asarray(mean, dtype=np.float64)
        covariance = np.asarray(covariance, dtype=np.float64)
        np.linalg.cholesky(covariance)
        sd_log_mu, sd = np.sqrt(np.diag(covariance))
    except (TypeError, ValueError, np.linalg.LinAlgError):
        expected = "two numbers, and a positive definite 2 x 2 matrix"
        raise ConfigError(f"mean is {mean!r:.60}, covariance {covariance!r:.60}", expected=expected) from None
    priors = {"alpha": {"mean": alpha, "sd": sd}}
    if foundation is not None:
        factor, wide = foundation[0], math.hypot(sd_log_mu, math.log(foundation[1]))
        # a correlation of exactly 1 would make the covariance singular
        correlation = np.clip(covariance[0, 1] / (wide * sd), -0.99, 0.99)
        median = factor * math.exp(log_mu)
        priors["mu_pa"] = {"median": median, "factor": math.exp(wide), "correlation": correlation}
    stated = {name: {key: float(f"{x:.6g}") for key, x in prior.items()} for name, prior in priors.items()}
    tables = {"schema": MaterialRecord.SCHEMA, **stated}
    check(tables, MaterialRecord, str(file))
    Path(file).write_text(dumps(tables), encoding="utf-8")
    return Path(file)


def _check_types(**options: object) -> None:
    """Raise ConfigError if an option has a wrong type, or `jobs` is below 1. None: it was not given."""
    for name, value in options.items():
        kind, expected = _OPTION_TYPES[name]
        if value is not None and (
            not isinstance(value, kind) or (kind is Sequence and isinstance(value, str))
        ):
            raise ConfigError(f"`{name}` is {value!r:.60}", expected=expected)
    if isinstance(jobs := options.get("jobs"), int) and jobs < 1:
        raise ConfigError(f"`jobs` is {jobs}", expected="1 or more")


def _open_fit(target: Name | Dataset | Run, medium: Medium | None, stored: bool = True) -> StatedStudy:
    """Return the fit of a dataset with a medium, of a run, or of a file."""
    if medium is not None:
        return _begin_fit(target, medium, stored)
    if isinstance(target, Dataset):
        fix = 'name the model: fit(dataset, "phantom1")'
        raise ConfigError("a dataset alone cannot be fitted", fix=fix)
    if isinstance(target, Run):
        return _reopen(target)
    name, record, inputs, file, _ = load_target(spell_name(target))
    return StatedStudy(name, record, inputs, file)


def _begin_fit(target: Name | Dataset | Run, medium: Medium, stored: bool) -> StatedStudy:
    if isinstance(target, Run):
        raise ConfigError("a run has a medium already", fix="leave `medium` out, or give the dataset")
    table = {"schema": FitRecord.SCHEMA, "dataset": IN_MEMORY, "medium": IN_MEMORY}
    empty = StatedStudy("", check(table, FitRecord, "needlefit.fit"))
    job = _replace_inputs(empty, target, medium, stored=stored)
    record, inputs = _require_fit(job.record), job.inputs
    dataset = load_dataset(record.dataset) if inputs.dataset is None else inputs.dataset
    inputs = replace(inputs, dataset=dataset)
    if inputs.medium:
        return StatedStudy(dataset.name, record, inputs)
    stem = Path(record.medium).stem
    if stem in dataset.media and len(dataset.media) > 1:
        media = f"{len(dataset.media)} media of {dataset.name}"
        note = f"Fitted to the insertions into {stem}, one of the {media}."
        record = record.model_copy(update={"tune": SelectionRecord(medium=stem), "note": note})
    return StatedStudy(f"{dataset.name}-{stem}", record, inputs)


def _load_study(study: Name | FileRecord | Table) -> StatedStudy:
    """Return a study by its record, its keys, or the name of its file."""
    if isinstance(study, FileRecord):
        return StatedStudy("study", study)
    if isinstance(study, Mapping):
        return StatedStudy("study", check_study(study, "needlefit.validate"))
    (name, file), *others = find_studies(spell_name(study))
    if others:
        raise ConfigError(
            f"`{study}` means several studies",
            expected="a single one",
            fix=f"run them one by one: {', '.join([name, *(other for other, _ in others)])}",
        )
    return StatedStudy(name, load_study_file(file), file=file)


def _require_fit(record: FileRecord) -> FitRecord:
    """Return the record of a study that fits and scores, or of a fit; ConfigError for another."""
    if isinstance(record, FitRecord):
        return record
    raise ConfigError(
        "only a study without `kind` takes another dataset, tissue model or recipe",
    )


def _prepare(study: StatedStudy, seed: int | None, jobs: int | None) -> tuple[Job, int]:
    """Return the job of a study that is computed here, without a run, and the threads to use."""
    _check_types(seed=seed, jobs=jobs)
    settings = Settings(seed=seed, jobs=count_cores() if jobs is None else jobs, inputs=study.inputs)
    with add_file_context(study.file):
        return load_study(study.name, _require_fit(study.record), settings), settings.jobs


def _integrate(job: Job, problem: Problem, key: tuple[str, ...], jobs: int) -> WeightedDraws:
    """Return weighted draws of a problem, with its evidence; `key` is that of the random stream."""
    rng = job.random(*key)
    fit = minimize(problem, job.recipe, rng, Callbacks(jobs=jobs))
    return sample_about_fit(problem, fit, rng, jobs)


def _require_noise(job: Job) -> Job:
    """Return a job whose dataset states its noise; ConfigError for another."""
    if job.recipe.minimize == "posterior":
        return job
    raise ConfigError(
        "densities of the data need the errors of the points", expected="a dataset that states its noise"
    )


def _fit(
    target: Name | Dataset | Run,
    medium: Medium | None,
    *,
    sample: bool = False,
    tune: Table | None = None,
    recipe: Recipe | None = None,
    priors: Mapping[int, Name] | None = None,
    free: Sequence[str] = (),
    fix: Mapping[str, float] | None = None,
    **options: Unpack[RunOptions],
) -> Run:
    changed = _change_fit(_open_fit(target, medium), tune, recipe, priors, free, fix)
    return _run(changed, sample=sample, **options)


def _replace_inputs(
    study: StatedStudy,
    dataset: Name | Dataset | None = None,
    medium: Medium | None = None,
    recipe: Recipe | None = None,
    *,
    stored: bool = True,
) -> StatedStudy:
    """Return a study with other data, another tissue model or recipe.

    Of a run that may be `stored`, the dataset must be what its files hold.
    """
    if dataset is None and medium is None and recipe is None:
        return study
    record, inputs = _require_fit(study.record), study.inputs
    changes: dict[str, Any] = {}
    if isinstance(dataset, Dataset):
        inputs = replace(inputs, dataset=_require_unchanged(dataset) if stored else dataset)
        changes["dataset"] = _name_dataset(dataset)
    elif dataset is not None:
        changes["dataset"] = spell_name(dataset)
    if isinstance(medium, Name):
        changes["medium"] = spell_name(medium)
    elif medium is not None:
        given, changes["medium"] = read_given("medium", medium, MediumRecord)
        inputs = replace(inputs, medium=given)
    if recipe is not None:
        chosen, changes["recipe"] = _read_recipe(recipe)
        inputs = replace(inputs, recipe=chosen)
    record = check(_plain(record, changes), type(record), "needlefit.validate")
    return replace(study, record=record, inputs=inputs)


def _change_fit(
    study: StatedStudy,
    tune: Table | None = None,
    recipe: Recipe | None = None,
    priors: Mapping[int, Name] | None = None,
    free: Sequence[str] = (),
    fix: Mapping[str, float] | None = None,
) -> StatedStudy:
    """Return a fit with the changes that were asked for."""
    _check_types(tune=tune, priors=priors, free=free, fix=fix)
    record, inputs, fix = _require_fit(study.record), study.inputs, fix or {}
    changes: dict[str, Any] = {}
    if tune is not None:
        changes["tune"] = tune
    if priors is not None:
        changes["priors"] = {str(layer): str(file) for layer, file in priors.items()}
    if recipe is not None:
        chosen, changes["recipe"] = _read_recipe(recipe)
        inputs = replace(inputs, recipe=chosen)
    record = check(_plain(record, changes), type(record), "needlefit.fit")
    medium = inputs.medium and set_priors(inputs.medium, {} if priors is None else read_priors(record))
    record, medium = change_fit(record, medium, free, fix, "needlefit.fit")
    return replace(study, record=record, inputs=replace(inputs, medium=medium))


def _reopen(run: Run) -> StatedStudy:
    """Return the fit of a run, with its data, medium, recipe and posterior."""
    return StatedStudy(*reopen_fit(run, f"run `{run.name}`"))


def _read_recipe(value: Recipe) -> tuple[RecipeRecord, str]:
    """Return a recipe and its name; a table changes keys of the default one."""
    if isinstance(value, Mapping):
        default, _ = read_given("recipe", "default", RecipeRecord)
        value = _plain(default, {"title": "", **value})
    return read_given("recipe", value, RecipeRecord)


def _plain(record: FileRecord | None, changes: Table) -> dict[str, Any]:
    """Return the keys of a record, with changes, as JSON values."""
    table = {} if record is None else record.model_dump(mode="json", by_alias=True)
    return table | {key: to_json_values(value) for key, value in changes.items()}


def _name_dataset(dataset: Dataset) -> str:
    """Return the name by which a dataset is found again: its bare one, or its path."""
    try:
        stored: Path | None = find_file("dataset", dataset.path.parent.name)
    except ConfigError:
        stored = None
    return dataset.path.parent.name if stored == dataset.path else str(dataset.path)


def _require_unchanged(dataset: Dataset) -> Dataset:
    """Return a dataset that is what its files hold, so that a run's record of it is true."""
    stored = read(dataset.path)
    pairs = zip(dataset.insertions, stored.insertions, strict=False)
    same = len(dataset.insertions) == len(stored.insertions) and all(_is_same(*pair) for pair in pairs)
    if not same or dataset.noise != stored.noise:
        raise ConfigError(
            "the dataset is not what its files hold",
            where=dataset.path,
            expected="a dataset as `load_dataset` returns it",
            fix="select insertions with `tune`; write changed data to a folder of their own",
        )
    return dataset


def _is_same(insertion: Insertion, other: Insertion) -> bool:
    plain = (np.ndarray, float, int, str)
    values = ((getattr(insertion, field.name), getattr(other, field.name)) for field in fields(insertion))
    same = all(np.array_equal(a, b) for a, b in values if isinstance(a, plain))
    return same and insertion.needle == other.needle


def _run(
    study: StatedStudy,
    *,
    sample: bool = False,
    name: str | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    progress: bool | Progress = False,
    checkpoint: Name | None = None,
) -> Run:
    _check_types(name=name, seed=seed, jobs=jobs)
    name = name or study.name
    checkpoint = None if checkpoint is None else Path(checkpoint)
    with _catch_interrupts() as stop, _show_progress(progress) as report:
        settings = Settings(
            seed=seed,
            jobs=count_cores() if jobs is None else jobs,
            checkpoint=checkpoint,
            resume=checkpoint is not None and is_dir(checkpoint),
            sample=sample,
            progress=report,
            stop=stop,
            note=warnings.warn,
        )
        result = run_study(replace(study, name=name), settings)
    if checkpoint is not None and not result.interrupted:
        remove_checkpoint(checkpoint, warnings.warn)
    has_fit = result.kind == "fit" and "fitted" in set(result.frames["errors"]["method"])
    if result.interrupted and not has_fit:  # the best fit so far is worth having
        raise KeyboardInterrupt(f"{name} was interrupted before there was a result")
    return result


@contextmanager
def _catch_interrupts() -> Iterator[Stop]:
    """Yield the question whether Ctrl-C was pressed; the second time it raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield never_stop  # signals reach the main thread alone
        return
    pressed = threading.Event()

    def on_signal(number: int, frame: object) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        pressed.set()

    before = signal.signal(signal.SIGINT, on_signal)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _show_progress(progress: bool | Progress) -> Iterator[Callable[[str, int, int], None]]:
    """Yield what a run calls with its progress; True rewrites one line on stderr, as notebooks show it."""
    if not isinstance(progress, bool):
        yield progress
        return
    if not progress:
        yield no_progress
        return
    yield lambda task, done, of: print(f"\r\033[K{task}: {done} of {of}", end="", file=sys.stderr, flush=True)
    print("\r\033[K", end="", file=sys.stderr)
