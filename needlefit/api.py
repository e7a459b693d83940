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
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.folds import divide_insertions
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.insertion import Insertion as Insertion
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.inference.draws import thin_posterior
from needlefit.inference.ecdf_band import ecdf_band as ecdf_band
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import WeightedDraws, sample_about_fit
from needlefit.inference.sampling.pareto_smoothing import MAX_PARETO_K, leave_out_parts
from needlefit.project.callbacks import Progress, Stop, never_stop, no_progress
from needlefit.project.checkpoint import remove_checkpoint
from needlefit.project.cluster import connect_cluster as connect_cluster
from needlefit.project.input_files import is_dir
from needlefit.project.locate import find_file, find_run
from needlefit.project.processes import count_cores
from needlefit.project.tasks import LocalPool as LocalPool
from needlefit.project.toml import IN_MEMORY, check, dumps, read_given, spell_name
from needlefit.schemas.base import FileRecord
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.studies.from_memory import (
    Medium,
    Name,
    Recipe,
    Table,
    change_stated_fit,
    check_types,
    open_fit,
    open_study,
    prepare_job,
    reopen_run,
    replace_inputs,
)
from needlefit.studies.job import Job, Settings, StatedStudy, run_study
from needlefit.studies.judge import REFERENCES as REFERENCES
from needlefit.studies.judge import compare_with_references as compare_with_references
from needlefit.studies.judge import judge_fits as judge_fits
from needlefit.studies.kind import find_kind
from needlefit.studies.load import load_target
from needlefit.studies.run import Run, restore_run

ELPD_DRAWS = 1000  #: number of posterior draws by which left-out data are scored


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
        fitted, run = reopen_run(target), target
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
    changed = replace_inputs(open_study(study), dataset, medium, recipe)
    return _run(changed, **options)


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
    job, jobs = prepare_job(reopen_run(run), None, jobs)
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
    changed = change_stated_fit(open_fit(target, medium, stored=False), **changes)
    job, _ = prepare_job(changed, None, None)
    return job.problem(job.folds[0])


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
    changed = change_stated_fit(open_fit(target, medium), tune, recipe, priors, free, fix)
    return _run(changed, sample=sample, **options)


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
    check_types(name=name, seed=seed, jobs=jobs)
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
