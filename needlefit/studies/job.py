"""What a study or fit works on, and how it is executed."""

import json
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import NoiseFloor
from needlefit.errors import NeedlefitError, UnfinishedWorkError
from needlefit.inference.likelihood.observations import estimate_floor, measures_tip
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.inference.parameters import Parameters, without_bevel_spread, without_prior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.project.callbacks import Note, Progress, Stop, never_stop, no_note, no_progress
from needlefit.project.checkpoint import abandon_checkpoint, release_checkpoint
from needlefit.project.processes import one_thread
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.tasks import TaskPool
from needlefit.project.toml import add_file_context, add_study_context, locate_key
from needlefit.schemas.base import FileRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.kind import kind_of
from needlefit.studies.run import Run

MAX_KEPT_PROBLEMS = 4  #: largest number of problems that are kept: as many as the searches of a fold
#: noise floors of insertions that are in use, by what else they depend on
_floors: WeakKeyDictionary[Insertion, dict[object, NoiseFloor]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Inputs:
    """What a program has in memory; it takes the place of the files that the study file of one fit names."""

    #: the name of the results of the fit that a study is about, and the fit
    target: tuple[str, FitRecord] | None = None
    #: dataset, medium, recipe: of the fit; the medium has its priors
    dataset: Dataset | None = None
    medium: MediumRecord | None = None
    recipe: RecipeRecord | None = None
    posterior: Posterior | None = None  #: that was sampled of the target
    judged: Run | None = None  #: of the target whose verdict a prediction repeats


@dataclass(frozen=True)
class StatedStudy:
    """A study or fit that is to be run: its keys, what stands for files that they name, and its own file."""

    name: str  #: of its results
    record: FileRecord
    inputs: Inputs = Inputs()
    file: Path | None = None


@dataclass(frozen=True)
class Settings:
    """How a run is executed; only `seed`, `sample` and `inputs` change its result."""

    seed: int | None = None  #: replaces the recipe's
    jobs: int = 1  #: threads
    checkpoint: Path | None = None  #: folder that keeps finished fits
    resume: bool = False  #: go on from the checkpoint
    sample: bool = False  #: also sample the posterior
    progress: Progress = no_progress  #: called with a label, what is done, and of how much
    stop: Stop = never_stop  #: asked often; True ends the run early, marked `interrupted`
    first: Note = no_note  #: given the first finding in one line, long before the run ends
    note: Note = no_note  #: given a line about what was damaged in the checkpoint
    pool: TaskPool | None = None  #: runs the folds; None: `jobs` processes of this machine
    file: Path | None = None  #: the study's, which warnings about it name
    inputs: Inputs = Inputs()  #: what is not read from files


@dataclass(frozen=True)
class Job:
    """What a study works on: data, tissue model, parameters, recipe; `warnings` are about these.

    The files of the study and of the medium are None where they were given in memory.
    """

    name: str
    record: FitRecord
    dataset: Dataset
    medium: MediumRecord
    parameters: Parameters
    recipe: RecipeRecord
    hand_tuned: Mapping[str, float] | None
    folds: tuple[Fold, ...]
    measured: Dataset  #: as it was read, before the planes of `dataset` were chosen
    file: Path | None = None
    medium_file: Path | None = None
    warnings: tuple[ResultWarning, ...] = ()
    response_at: Mapping[str, float] | None = None  #: as of `Problem`
    _problems: dict[tuple[Fold, str], Problem] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def place(self, key: str) -> str:
        """Return how messages name a key of the study's file; "" where it is not known."""
        return "" if self.file is None else locate_key(self.file, key)

    def place_in_medium(self, key: str) -> str:
        """Return how messages name a key of the medium."""
        return key if self.medium_file is None else locate_key(self.medium_file, key)

    def holding(self, names: Collection[str]) -> "Job":
        """Return the work of which only `names` are held, among the parameters that are."""
        return replace(self, parameters=self.parameters.holding(names))

    def responds_to_moves(self, fold: Fold) -> bool:
        """Return whether errors depend on how the tips of a fold respond to moves of a guide."""
        guided = any(insertion.guided for insertion in (*fold.tune, *fold.validate))
        return guided and self.recipe.likelihood.tip_tracks.gain_sd > 0

    @property
    def searches(self) -> tuple[str, ...]:
        """The searches of one fold; the first is the fit that everything else is about."""
        metric = self.recipe.metric and self.recipe.minimize == "posterior"
        metric = metric and all(map(measures_tip, self.insertions))
        others = {*self.parameters.free} - {self.medium.bevel_parameter, *HYPERPARAMETERS}
        alone = isinstance(self.record, StudyRecord) and self.record.registration_depth_mm is None
        alone = alone and bool(others) and self.medium.bevel_parameter in self.parameters.free
        return (
            "fitted",
            *(["fitted_metric"] * metric),
            *(["b_alone"] * alone),
        )

    def recipe_of(self, search: str) -> RecipeRecord:
        """Return the recipe of one search; all minimise the same, except the one named after the metric."""
        return metric_recipe(self.recipe) if search == "fitted_metric" else self.recipe

    @property
    def insertions(self) -> tuple[Insertion, ...]:
        """Every insertion that is fitted to or scored in any fold, once."""
        by_id = {i.id: i for fold in self.folds for i in (*fold.tune, *fold.validate)}
        return tuple(by_id.values())

    def random(self, *keys: str | int) -> np.random.Generator:
        """Return the generator of one purpose, as of `random_stream`, by the seed of the recipe."""
        return random_stream(self.recipe.seed, *keys)

    def floor(self, insertion: Insertion) -> NoiseFloor:
        """Return the noise floor of an insertion; it is estimated once for all studies of a command."""
        data, computed = self.dataset, _floors.setdefault(insertion, {})
        key = (self.recipe.seed, data.noise, data.pose, data.drop_proximal)
        if key not in computed:
            computed[key] = estimate_floor(data, insertion, self.random("noise floor", insertion.id))
        return computed[key]

    def problem(self, fold: Fold, search: str = "fitted") -> Problem:
        """Return the problem of one search of a fold: all parameters free, or the bevel alone.

        The others are then as they are before any data: at the median of their prior. The latest ones are
        kept, with what they have computed once.
        """
        if (fold, search) not in self._problems:
            while len(self._problems) >= MAX_KEPT_PROBLEMS:
                del self._problems[next(iter(self._problems))]
            self._problems[fold, search] = self._make_problem(fold, search)
        return self._problems[fold, search]

    def _make_problem(self, fold: Fold, search: str) -> Problem:
        everything = Problem(
            self.dataset,
            fold.tune,
            self.medium,
            self.parameters,
            self.recipe.weights,
            likelihood=self.recipe.likelihood,
            response_at=self.response_at,
        )
        if search == "b_alone":
            values = self.parameters.values(self.parameters.expected)
            one_bevel = without_bevel_spread(self.parameters)
            return everything.with_parameters(one_bevel.with_only((self.medium.bevel_parameter,), values))
        if self.recipe_of(search).minimize == "metric":
            return everything.with_parameters(without_prior(self.parameters))
        return everything


def metric_recipe(recipe: RecipeRecord) -> RecipeRecord:
    """Return the recipe that minimises the metric objective instead of the posterior."""
    return recipe.model_copy(update={"minimize": "metric"})


@one_thread
def run_study(study: StatedStudy, settings: Settings) -> Run:
    """Run a study of the kind of its record; its file and inputs take the place of those of `settings`.

    The same record, data, seed and versions give the same frames for any number of jobs, and after an
    interruption with `resume`. A run that is complete still has the lock of its checkpoint: the caller
    writes the run, then removes or releases it.

    Raises ConfigError or DataError if anything the record names is missing or wrong.
    """
    begin, complete = time.time(), False
    try:
        settings = replace(settings, file=study.file, inputs=study.inputs)
        with add_file_context(study.file), add_study_context(study.name):
            run: Run = kind_of(study.record).load("run").run(study.name, study.record, settings)
        complete = not run.interrupted
    except UnfinishedWorkError:
        raise
    except NeedlefitError:
        if settings.checkpoint is not None:
            abandon_checkpoint(settings.checkpoint, settings.note)
        raise
    finally:
        if settings.checkpoint is not None and not complete:
            release_checkpoint(settings.checkpoint)
    timing = {
        "seconds": time.time() - begin,
        "jobs": settings.jobs,
        # what does not change a result; the date is UTC
        "command": shlex.join(sys.argv),
        "folder": str(Path.cwd()),
        "platform": platform.platform(),
        "started": datetime.fromtimestamp(begin, UTC).isoformat(timespec="seconds"),
    }
    run = run.with_metadata(interrupted=run.interrupted, faults=list(map(str, run.faults)))
    if revision := find_source_revision():
        run = run.with_metadata(source_revision=revision)
    return replace(run, timing=timing | run.timing)


GIT_SECONDS = 5.0  # longest time (s) that git is waited for


@cache
def find_source_revision() -> str:
    """Return the commit that needlefit was installed from or that is checked out; empty if neither is known.

    "-dirty" is appended where files of the checkout were changed since.
    """
    origin = json.loads(distribution("needlefit").read_text("direct_url.json") or "{}")
    installed = origin.get("vcs_info", {}).get("commit_id", "")
    checkout = Path(__file__).parents[2]
    if installed or not (checkout / ".git").exists():
        return str(installed)
    command = ("git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):  # no git, or a checkout on a slow disk
        return ""
    return done.stdout.strip()
