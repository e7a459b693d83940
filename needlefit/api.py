"""Fit, sample, predict and validate from Python; each returns a `Run`, as the commands write it.

Inputs are names (of what ships, or lies in the working folder), paths, or records, tables and datasets in
memory. Nothing is written but by `Run.save`, `make_twin`, `write_prior`, and with `checkpoint`.
"""

import math
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any, TypedDict, Unpack, get_type_hints

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.parameter_changes import change_parameters
from needlefit.inference.sampling.importance import sample_about_fit
from needlefit.project.checkpoint import remove_checkpoint
from needlefit.project.input_files import is_dir
from needlefit.project.json_values import to_json_values
from needlefit.project.locate import find_file, find_run, find_studies
from needlefit.project.processes import count_cores
from needlefit.project.progress import Progress, Stop, never_stop, no_progress
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, TaskPool
from needlefit.project.toml import IN_MEMORY, add_file_context, check, dumps, read_given, spell_name
from needlefit.schemas.analyses import SyntheticDataRecord
from needlefit.schemas.base import FileRecord
from needlefit.schemas.medium import MaterialRecord, MediumRecord, spell_parameter
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.job import Inputs, Job, Settings, change_fit, prepare, set_priors
from needlefit.studies.judge import judge_fits as judge_fits
from needlefit.studies.kind import find_kind, kind_of
from needlefit.studies.kinds.prediction import require_same_configuration
from needlefit.studies.run import Run
from needlefit.studies.score import Scorer, make_predictors
from needlefit.studies.store import restore_run
from needlefit.studies.study_files import check_study, load_study, load_target

Name = str | Path
Table = Mapping[str, Any]
Medium = Name | MediumRecord | Table

_OPTION_TYPES: Mapping[str, type] = {
    **{"name": str, "seed": int, "jobs": int},
    **{"tune": Mapping, "priors": Mapping, "fix": Mapping, "free": Sequence},
}


class RunOptions(TypedDict, total=False):
    """How a run is executed; only `seed` changes numbers, and `name`, which keys its random streams.

    Attributes
    ----------
    name : str
        Of the result; by default made of what is run.
    seed : int
        Of all random numbers, in place of the recipe's.
    jobs : int
        Threads; by default as many as there are cores.
    pool : TaskPool
        Where tasks of analyses run; by default in this process. `LocalPool(N)` starts
        N processes: the script then needs `if __name__ == "__main__"`.
    progress : bool or callable
        True prints to stderr; a callable is given what is being done, how much is done, and of how much.
    checkpoint : str or Path
        A folder that keeps finished work; the same call goes on from there. It is removed at the end.
    """

    name: str
    seed: int
    jobs: int
    pool: TaskPool
    progress: bool | Progress
    checkpoint: Name


class StudyChanges(RunOptions, total=False):
    """What a study is run with, in place of what its file names, and how it is executed.

    Attributes
    ----------
    dataset : str, Path or Dataset
        Another dataset, with insertions of the same names: `make_twin(folder, 2)`.
    medium : str, Path, MediumRecord or table
        Another tissue model: `load_medium("phantom2") | {"tangent_part": 0.5}`.
    recipe : str, Path, RecipeRecord or table
        How to search and sample, as of `FitChanges`.
    """

    dataset: Name | Dataset
    medium: Medium
    recipe: Name | RecipeRecord | Table


class FitChanges(RunOptions, total=False):
    """What a fit is made with, in place of what its file names, and how it is executed.

    Attributes
    ----------
    tune : table
        The insertions fitted to, by the keys of `[tune]`: `{"layers": [3]}`. By default all.
    recipe : str, Path, RecipeRecord or table
        How to search and sample; a table changes keys of the recipe `default`: `{"starts": 4}`.
    priors : mapping
        By number of the layer: the file that `write_prior` wrote.
    free : sequence of str
        Parameters to estimate although the model fixes or ties them: `["alpha1"]`.
    fix : mapping
        Parameters to hold at a value, in Pa, mm or degrees: `{"mu1": 4e3, "b": 0.1}`.
    """

    tune: Table
    recipe: Name | RecipeRecord | Table
    priors: Mapping[int, Name]
    free: Sequence[str]
    fix: Mapping[str, float]


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


def make_twin(folder: Name, seed: int, media: Sequence[str] = ()) -> Dataset:
    """Write the synthetic dataset of another seed to `folder`, and return it.

    It is measured as a scan would, but not rendered: a second for two insertions.

    Parameters
    ----------
    folder : str or Path
        A new folder for its files.
    seed : int
        Of specimens, bevels and errors of measurement; the plan of the 47 insertions is the same.
    media : sequence of str
        Insertions into these media only, such as `["chicken"]`.

    Raises
    ------
    ConfigError
        If there is no insertion into such a medium.
    """
    from needlefit.synthetic.build import build_unscanned
    from needlefit.synthetic.design import list_planned_insertions

    plan = [one for one in list_planned_insertions() if not media or one.medium in media]
    if missing := set(media) - {one.medium for one in plan}:
        raise ConfigError(f"the twin has no insertions into {', '.join(sorted(missing))}")
    return read(build_unscanned(Path(folder), seed, plan))


def simulate_twin_needle(name: str, from_tip: ArrayLike) -> Floats:
    """Return the points (N, 3) of a true needle of the shipped twin, world, mm: without any error.

    Parameters
    ----------
    name : str
        An insertion of the dataset `twin`, such as "phantom2-01".
    from_tip : (N,) array_like
        Arc lengths from the tip, mm.

    Raises
    ------
    ConfigError
        If there is no such insertion.
    """
    from needlefit.synthetic.design import select_planned_insertions
    from needlefit.synthetic.insertion import TWIN_SEED, needle_points, simulate_insertion

    (planned,) = select_planned_insertions([name])
    made = simulate_insertion(planned, TWIN_SEED)
    shape, frame = made.true_insertion.shape, made.true_insertion.frame
    return needle_points(shape, frame, made.deviations, shape.depth - np.asarray(from_tip, dtype=np.float64))


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
    from needlefit.studies.simulated_data import simulate_dataset

    record = check(_plain(None, data), SyntheticDataRecord, "needlefit.api.simulate_dataset")
    return simulate_dataset("simulated", record, read_given("medium", medium, MediumRecord)[0], seed)


def load_run(folder: Name) -> Run:
    """Return the run that `Run.save` or a command wrote to `folder`, or to `reports/<folder>`.

    Raises
    ------
    ConfigError, DataError
        If there is none, its files are damaged, or do not agree with the manifest.
    """
    return restore_run(find_run(spell_name(folder)))


def fit(target: Name | Dataset, medium: Medium | None = None, **options: Unpack[FitChanges]) -> Run:
    """Fit the parameters of a tissue model (mu in Pa, alpha, b in mm) to measured insertions.

    Parameters
    ----------
    target : str, Path or Dataset
        With `medium`: the data. Without: what ships or your file names, a fit (`"phantom1"`) or a study
        (`"study3"`), of which the tuning alone is done.
    medium : str, Path, MediumRecord or table, optional
        The model: layers, and which parameters are free.
    **options
        See `FitChanges`.

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
    return _fit(target, medium, options, sample=False)


def sample(
    target: Name | Dataset | Run,
    medium: Medium | None = None,
    **options: Unpack[FitChanges],
) -> Run:
    """Fit as `fit`, then sample the posterior by MCMC, as `needlefit tune` does.

    Parameters
    ----------
    target, medium, **options
        As of `fit`; `target` may also be a run of kind `fit`, or of a study with one fold.

    Returns
    -------
    Run
        With `posterior`, whose `to_xarray()` is for ArviZ. Ctrl-C ends early, marked `interrupted`.

    Raises
    ------
    ConfigError, DataError, FitError
        As `fit`; also if the data that `target` was fitted to are no longer the same.
    """
    return _fit(target, medium, options, sample=True)


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
    _check_options(options, RunOptions)
    if not isinstance(specimen, str | None):
        raise ConfigError(f"`specimen` is {specimen!r:.60}", expected='"new", "same", or a name')
    if isinstance(target, Run):
        name, fitted, inputs = _reopen(target)
        inputs = replace(inputs, target=(name, fitted), judged=target)
    else:
        name, inputs = load_target(spell_name(target))[0], Inputs()
    planned, scene_name = read_given("scene", scene, SceneRecord)
    about = name.removesuffix("-tune")
    record = find_kind("prediction").make_record(
        target=about if isinstance(target, Run) else spell_name(target),
        scene=planned,
        scene_name=scene_name,
        posterior=None if inputs.posterior is None else about,
        specimen=specimen,
    )
    stem = Path(scene_name).stem if scene_name != IN_MEMORY else "scene"
    return _run(record, f"predict-{about}-{stem}", Settings(inputs=inputs), options)


def validate(study: Name | FileRecord | Table, **options: Unpack[StudyChanges]) -> Run:
    """Run a study of any kind: fit and score held-out insertions, or whatever else its file asks.

    Parameters
    ----------
    study : str, Path, record or table
        A name such as `study3`, a path, or the keys of a study file.
    **options
        See `StudyChanges`: of a study that fits and scores, other data and another model.

    Raises
    ------
    ConfigError, DataError
        If anything that is named is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    KeyboardInterrupt
        With Ctrl-C.
    """
    _check_options(options, StudyChanges)
    name, record, file = _load_study(study)
    inputs = Inputs()
    if options.keys() & {"dataset", "medium", "recipe"}:
        record, inputs = _replace_inputs(record, options)
    return _run(record, name, Settings(inputs=inputs, file=file), options)


def score_study(study: Name | FileRecord | Table, **options: Unpack[StudyChanges]) -> pd.DataFrame:
    """Fit a study, and return the errors of every method on every insertion.

    Intervals, predictions and the error-minimising fit of `validate` are left out: seconds instead of a
    minute. Layers are where the needle was measured to cross them, as in the paper's tables.

    Parameters
    ----------
    study : str, Path, record or table
        A study that fits and scores, or a fit, as of `validate`.
    **options
        See `StudyChanges`; the dataset may be changed in memory.

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
    _check_options(options, StudyChanges)
    name, record, file = _load_study(study)
    record, inputs = _replace_inputs(record, options, stored=False)
    job, jobs = _prepare(name, record, file, inputs, options)
    scorer = Scorer(job.dataset, record.layer_count_rule, {one.id: job.floor(one) for one in job.insertions})
    rows = []
    for fold in job.folds:
        problem = job.problem(fold)
        fits = {
            search: minimize(
                job.problem(fold, search),
                job.recipe_of(search),
                random_stream(job.recipe.seed, fold.name, search, "starts"),
                Callbacks(jobs=jobs),
            )
            for search in job.searches
            if search != "fitted_metric"
        }
        methods = make_predictors(problem, fits, job.hand_tuned)
        for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
            for insertion, (method, curves) in product(insertions, methods.items()):
                place = {"fold": fold.name, "role": role, "method": method}
                rows += scorer.score(place, replace(insertion, surfaces=()), curves)[0]
    return pd.DataFrame(rows).drop(columns=["boundaries", "comparison"])


def estimate_evidence(
    target: Name | Dataset, medium: Medium | None = None, **options: Unpack[FitChanges]
) -> "pd.Series[float]":
    """Return the evidence of a tissue model: the probability density of the data, over all its parameters.

    The log density of insertions B predicted from insertions A is the evidence of both, less that of A. The
    integral is by importance sampling about the modes of the fit.

    Parameters
    ----------
    target, medium, **options
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
    if medium is None:
        if isinstance(target, Dataset):
            raise ConfigError("a dataset alone has no evidence", fix='name the model: "phantom1"')
        name, record, file = load_target(spell_name(target))
        inputs = Inputs()
    else:
        name, record, inputs = _begin_fit(target, medium, stored=False)
        file = None
    record, inputs = _change_fit(record, inputs, options)
    job, jobs = _prepare(name, record, file, inputs, options)
    if job.recipe.minimize != "posterior":
        raise ConfigError(
            "an evidence needs the errors of the points", expected="a dataset that states its noise"
        )
    problem = job.problem(job.folds[0])
    rng = random_stream(job.recipe.seed, "evidence")
    fit = minimize(problem, job.recipe, rng, Callbacks(jobs=jobs))
    found = sample_about_fit(problem, fit, rng, jobs)
    values = (found.log_evidence, found.log_evidence_se, found.k, found.effective_sample_size)
    return pd.Series(values, index=["log_evidence", "se", "k", "ess"])


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
    stated = {name: {key: float(f"{x:.6g}") for key, x in one.items()} for name, one in priors.items()}
    tables = {"schema": MaterialRecord.SCHEMA, **stated}
    check(tables, MaterialRecord, str(file))
    Path(file).write_text(dumps(tables), encoding="utf-8")
    return Path(file)


def _fit(target: Name | Dataset | Run, medium: Medium | None, options: FitChanges, sample: bool) -> Run:
    file, inputs = None, Inputs()
    if medium is None:
        if isinstance(target, Dataset):
            raise ConfigError(
                "a dataset alone cannot be fitted", fix='name the model: fit(dataset, "phantom1")'
            )
        if isinstance(target, Run):
            name, record, inputs = _reopen(target)
        else:
            name, record, file = load_target(spell_name(target))
    else:
        name, record, inputs = _begin_fit(target, medium)
    record, inputs = _change_fit(record, inputs, options)
    return _run(record, name, Settings(sample=sample, inputs=inputs, file=file), options)


def _check_options(options: RunOptions, known: type) -> None:
    """Raise ConfigError if an option is not known, or of a wrong type."""
    for name, value in options.items():
        if name not in (names := get_type_hints(known)):
            raise ConfigError(f"there is no option `{name}`", expected=f"one of {', '.join(names)}")
        if not isinstance(value, kind := _OPTION_TYPES.get(name, object)):
            raise ConfigError(f"`{name}` is {value!r:.60}", expected=f"a {kind.__name__}")


def _begin_fit(
    target: Name | Dataset | Run, medium: Medium, stored: bool = True
) -> tuple[str, FitRecord, Inputs]:
    if isinstance(target, Run):
        raise ConfigError("a run has a medium already", fix="leave `medium` out, or give the dataset")
    table = {"schema": FitRecord.SCHEMA, "dataset": IN_MEMORY, "medium": IN_MEMORY}
    empty = check(table, FitRecord, "needlefit.fit")
    record, inputs = _replace_inputs(empty, {"dataset": target, "medium": medium}, stored)
    dataset = load_dataset(record.dataset) if inputs.dataset is None else inputs.dataset
    name = dataset.name if inputs.medium else f"{dataset.name}-{Path(record.medium).stem}"
    return name, record, replace(inputs, dataset=dataset)


def _load_study(study: Name | FileRecord | Table) -> tuple[str, FileRecord, Path | None]:
    """Return the name of a study, its record, and its file, which one in memory has not."""
    if isinstance(study, FileRecord):
        return "study", study, None
    if isinstance(study, Mapping):
        return "study", check_study(study, "needlefit.validate"), None
    (name, file), *others = find_studies(spell_name(study))
    if others:
        raise ConfigError(
            f"`{study}` means several studies",
            expected="a single one",
            fix=f"run them one by one: {', '.join([name, *(other for other, _ in others)])}",
        )
    return name, load_study(file), file


def _prepare(
    name: str, record: FitRecord, file: Path | None, inputs: Inputs, options: RunOptions
) -> tuple[Job, int]:
    """Return the job of a study that is computed here, without a run, and the threads to use."""
    settings = Settings(seed=options.get("seed"), jobs=options.get("jobs", count_cores()), inputs=inputs)
    with nullcontext() if file is None else add_file_context(file):
        return prepare(name, record, settings), settings.jobs


def _replace_inputs(
    record: FileRecord, options: StudyChanges, stored: bool = True
) -> tuple[FitRecord, Inputs]:
    """Return a study, and what is in memory for it, with the files that were replaced.

    Of a run that may be `stored`, the dataset must be what its files hold.
    """
    if not isinstance(record, FitRecord):
        raise ConfigError(
            "only a study that fits and scores takes another dataset, tissue model or recipe",
            expected="a study file without `kind`",
        )
    changes: dict[str, Any] = {}
    inputs = Inputs()
    if "dataset" in options:
        dataset = options["dataset"]
        if isinstance(dataset, Dataset):
            inputs = replace(inputs, dataset=_require_unchanged(dataset) if stored else dataset)
            changes["dataset"] = _name_dataset(dataset)
        else:
            changes["dataset"] = spell_name(dataset)
    if "medium" in options:
        medium = options["medium"]
        if isinstance(medium, Name):
            changes["medium"] = spell_name(medium)
        else:
            given, changes["medium"] = read_given("medium", medium, MediumRecord)
            inputs = replace(inputs, medium=given)
    if "recipe" in options:
        recipe, changes["recipe"] = _read_recipe(options["recipe"])
        inputs = replace(inputs, recipe=recipe)
    return check(_plain(record, changes), type(record), "needlefit.validate"), inputs


def _change_fit(record: FitRecord, inputs: Inputs, options: FitChanges) -> tuple[FitRecord, Inputs]:
    """Return a fit, and what is in memory for it, with the changes that were asked for."""
    _check_options(options, FitChanges)
    changes: dict[str, Any] = {}
    if "tune" in options:
        changes["tune"] = options["tune"]
    if "priors" in options:
        changes["priors"] = {str(layer): str(file) for layer, file in options["priors"].items()}
    if "recipe" in options:
        recipe, changes["recipe"] = _read_recipe(options["recipe"])
        inputs = replace(inputs, recipe=recipe)
    record = check(_plain(record, changes), type(record), "needlefit.fit")
    free, fix = options.get("free", ()), options.get("fix", {})
    record = change_fit(record, free, fix, "needlefit.fit")
    if inputs.medium is not None:
        medium = set_priors(inputs.medium, record.priors if "priors" in options else {})
        values = {name: record.fix[name] for name in map(spell_parameter, fix)}
        medium = change_parameters(medium, [*map(spell_parameter, free)], values)
        inputs = replace(inputs, medium=medium)
    return record, inputs


def _reopen(run: Run) -> tuple[str, FitRecord, Inputs]:
    """Return the fit of a run with its medium, recipe and posterior; ConfigError if its data were changed."""
    record = run.record
    if not isinstance(record, FitRecord):
        raise ConfigError(
            f"`{run.name}` is a run of kind {run.kind}, no fit",
            expected="a run of `fit`, `sample`, or of a study that fits and scores",
        )
    where = f"run `{run.name}`"
    medium, recipe = (
        check(run.run["medium"], MediumRecord, where),
        check(run.run["recipe"], RecipeRecord, where),
    )
    inputs = Inputs(medium=medium, recipe=recipe)
    job = prepare(run.name, record, Settings(inputs=inputs))
    require_same_configuration(job, run.run, where)
    one_fit = len(run.posteriors) == 1 and len(job.folds) == 1
    inputs = replace(inputs, dataset=job.dataset, posterior=run.posterior if one_fit else None)
    if isinstance(record, StudyRecord):
        return f"{run.name}-tune", record.tuning(), inputs
    return run.name, record, inputs


def _read_recipe(value: Name | RecipeRecord | Table) -> tuple[RecipeRecord, str]:
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
        found: Path | None = find_file("dataset", dataset.path.parent.name)
    except ConfigError:
        found = None
    return dataset.path.parent.name if found == dataset.path else str(dataset.path)


def _require_unchanged(dataset: Dataset) -> Dataset:
    """Return a dataset that is what its files hold, so that a run's record of it is true."""
    stored = read(dataset.path)
    pairs = zip(dataset.insertions, stored.insertions, strict=False)
    same = len(dataset.insertions) == len(stored.insertions) and all(_is_same(*pair) for pair in pairs)
    if not same or dataset.noise != stored.noise:
        raise ConfigError(
            "the dataset is not what its files hold",
            where=str(dataset.path),
            expected="a dataset as `load_dataset` returns it: a run records the digest of its files",
            fix="select insertions with `tune`; write changed data to a folder of their own",
        )
    return dataset


def _is_same(one: Insertion, other: Insertion) -> bool:
    plain = (np.ndarray, float, int, str)
    values = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    same = all(np.array_equal(a, b) for a, b in values if isinstance(a, plain))
    return same and one.needle == other.needle


def _run(record: FileRecord, name: str, settings: Settings, options: RunOptions) -> Run:
    name, folder = options.get("name", name), options.get("checkpoint")
    checkpoint = None if folder is None else Path(folder)
    with _catch_interrupts() as stop, _show_progress(options.get("progress", False)) as progress:
        settings = replace(
            settings,
            seed=options.get("seed"),
            jobs=options.get("jobs", count_cores()),
            pool=options.get("pool", THIS_PROCESS),
            checkpoint=checkpoint,
            resume=checkpoint is not None and is_dir(checkpoint),
            progress=progress,
            stop=stop,
            note=warnings.warn,
        )
        place = nullcontext() if settings.file is None else add_file_context(settings.file)
        with place:
            result = kind_of(record).run(name, record, settings)
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
    yield lambda what, done, of: print(f"\r\033[K{what}: {done} of {of}", end="", file=sys.stderr, flush=True)
    print("\r\033[K", end="", file=sys.stderr)
