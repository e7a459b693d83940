"""The result of a study: tables, draws, verdicts, and what a reader needs to repeat it."""

from collections.abc import Callable, Hashable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import pandas as pd

from needlefit.datasets.sources import DatasetFiles
from needlefit.errors import ConfigError
from needlefit.inference.baselines import list_baselines
from needlefit.inference.sampling.posterior import Posterior
from needlefit.metrics import IPE
from needlefit.project.result_warnings import ResultWarning, condense_open_points
from needlefit.reporting.table_files import select_rows
from needlefit.schemas.origin import ORIGIN_MARKS, ORIGIN_NOTES, Origin
from needlefit.schemas.run_metadata import RunMetadata
from needlefit.studies.first_page import STATUSES, FirstPage, RunFault, Verdict, list_doubts
from needlefit.studies.kind import find_kind

Known = TypeVar("Known", bound=RunMetadata)
Given = ParamSpec("Given")
Value = TypeVar("Value")


def mark_faults(faults: Sequence[RunFault]) -> str:
    """Return the headlines of faults, each once, as sentences that stand before a result; "" without any."""
    kinds = dict.fromkeys(fault.kind for fault in faults)
    return "".join(f"{kind}. " for kind in kinds)


def _mark(run: "Run", verdict: Verdict) -> Verdict:
    """Return a verdict with what must be read before it; then it does not pass: "warn" at best."""
    head = "INTERRUPTED: the best found so far. " if run.interrupted else mark_faults(run.faults)
    if run.metadata.recipe is not None and run.metadata.recipe.preliminary:
        recipe = Path(str(getattr(run.record, "recipe", ""))).stem
        head += f"Preliminary (recipe {recipe}). " if recipe else "Preliminary. "
    status = verdict.status if run.reliable else max(verdict.status, "warn", key=STATUSES.index)
    word = verdict.word if run.reliable else f"not reliable: {verdict.word}"
    return replace(verdict, sentence=f"{head}{verdict.sentence}", status=status, word=word)


Frames = MutableMapping[str, pd.DataFrame]


@dataclass(frozen=True)
class Run:
    """The result of a study of any kind: tables, draws, provenance and faults.

    Attributes
    ----------
    kind : str
        Of study: which folder of `kinds` ran it and reports it.
    name : str
        Of the run.
    record : FileRecord
        The study file, or the options that stand for one.
    origin : "measured", "example" or "synthetic"
        Not measured as soon as anything in it is not.
    dataset_title : str
        The data, in words.
    frames : mapping of DataFrame
        One row a fact, the unit in every column's name.
    metadata : RunMetadata
        All that decides the result (versions, data, configuration, rules), and what was found as a whole.
    timing : dict
        Seconds, jobs, paths.
    interrupted : bool
        Whether some of the work was left undone.
    faults : tuple of RunFault
        Why something in it is not to be trusted.
    posteriors : mapping
        Sampled posteriors, by name of the fit or fold.
    data : DatasetFiles or None
        The files of the dataset that was fitted to; None of other kinds.
    """

    kind: str
    name: str
    record: Any = field(repr=False)
    origin: Origin
    dataset_title: str
    frames: Mapping[str, pd.DataFrame] = field(repr=False)
    metadata: RunMetadata = field(repr=False)
    timing: dict[str, Any] = field(repr=False)
    interrupted: bool = False
    faults: tuple[RunFault, ...] = ()
    posteriors: Mapping[str, Posterior] = field(default_factory=dict, repr=False)
    data: DatasetFiles | None = field(default=None, repr=False, compare=False)
    #: what `value_of_run` keeps: a run with other tables or metadata is another one, and begins without
    _values: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def run_json(self) -> dict[str, Any]:
        """What `run.json` holds: the kind, and all that decides the result."""
        return {"kind": self.kind, **self.metadata.to_json()}

    @property
    def warnings(self) -> tuple[ResultWarning, ...]:
        """What is suspicious about the data or the result."""
        return tuple(ResultWarning(**vars(warning)) for warning in self.metadata.warnings)

    def knows(self, kind: type[Known]) -> Known:
        """Return the metadata of a run of a kind; TypeError for a run of another one."""
        if not isinstance(self.metadata, kind):
            raise TypeError(f"{self.name} is of kind {self.kind}")
        return self.metadata

    def with_metadata(self, **stated: Any) -> Self:  # noqa: ANN401 - as pydantic's
        """Return the run, which also knows what is stated."""
        return replace(self, metadata=self.metadata.state(**stated))

    def with_frames(self, **frames: pd.DataFrame) -> Self:
        """Return the run with some tables replaced."""
        return replace(self, frames={**self.frames, **frames})

    @property
    def title(self) -> str:
        return str(getattr(self.record, "title", "") or self.name)

    @property
    def origin_mark(self) -> str:
        """What stands beside every result that is not of measured data."""
        return ORIGIN_MARKS[self.origin]

    @property
    def reliable(self) -> bool:
        """Whether it is complete and without faults."""
        return not (self.interrupted or self.faults)

    @property
    def posterior(self) -> Posterior:
        """The sampled posterior; ConfigError where none, or one of each of several folds, was sampled."""
        if len(self.posteriors) == 1:
            return next(iter(self.posteriors.values()))
        several = ", ".join(map(repr, self.posteriors))
        raise ConfigError(
            f"`{self.name}` has {'several posteriors' if several else 'no sampled posterior'}",
            fix=f"name one: run.posteriors[...] with {several}" if several else "use: needlefit.sample(run)",
        )

    @cached_property
    def first_page(self) -> FirstPage:
        """The first page, from the stored tables alone.

        A run that was interrupted, or that has faults, passes nowhere; the headlines of its faults come
        first. Those of a preliminary recipe are marked.
        """
        page: FirstPage = find_kind(self.kind).load("report").REPORT.first_page(self)
        return replace(
            page,
            verdict=_mark(self, page.verdict),
            about=page.about or ". ".join(dict.fromkeys((self.name, self.dataset_title))),
            title=self.title,
            question=str(getattr(self.record, "question", "")),
            origin_mark=self.origin_mark,
            origin_note=ORIGIN_NOTES[self.origin],
            interrupted=self.interrupted,
            faults=self.faults,
            warnings=list_doubts(condense_open_points(self.warnings)),
        )

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The answer in one sentence, with its status and numbers."""
        return (self.first_page.verdict,)

    def save(self, folder: Path | str) -> Path:
        """Write tables (CSV, LaTeX), figures, report and all that `load_run` reads to `folder`; return it.

        Raises
        ------
        ConfigError
            If `folder` holds anything that needlefit did not write, or that was changed since.
        """
        written: Path = find_kind(self.kind).load("report").REPORT.write(self, Path(folder))
        return written

    def _repr_html_(self) -> str:
        return str(find_kind(self.kind).load("report").REPORT.format_notebook_html(self))


def value_of_run(
    function: Callable[Concatenate[Run, Given], Value],
) -> Callable[Concatenate[Run, Given], Value]:
    """Return a function of a run that computes what it returns once: callers do not change it.

    Its further arguments can be hashed.
    """
    name = f"{function.__module__}.{function.__qualname__}"  # not the function: runs travel between processes

    @wraps(function)
    def find_value(run: Run, /, *args: Given.args, **kwargs: Given.kwargs) -> Value:
        key = (name, args, tuple(sorted(kwargs.items())))
        if key not in run._values:
            run._values[key] = function(run, *args, **kwargs)
        value: Value = run._values[key]
        return value

    return find_value


FIT_KINDS = ("cross_validation", "fit")  #: kinds of study whose runs have these tables

#: in place of a specimen's name: those that were tuned on, together, and one that is not in the dataset
TUNED_SPECIMENS, NEW_SPECIMEN = "(tuned)", "(new)"

#: our prediction: the needle of the posterior mode, through the layers that it meets itself, or the median
PREDICTION_METHOD = "prediction"
#: the methods that simulate a needle: both fits, b fitted alone with the others as they are before any data,
#: and the paper's parameters
MODEL_METHODS = ("fitted", "fitted_metric", "b_alone", "hand_tuned")


@dataclass(frozen=True)
class FitFrames:
    """The tables of a fit or cross-validation, by their names in `Run.frames`."""

    errors: pd.DataFrame
    shapes: pd.DataFrame
    starts: pd.DataFrame
    parameters: pd.DataFrame
    error_fit: pd.DataFrame
    directions: pd.DataFrame
    identification: pd.DataFrame
    profiles: pd.DataFrame
    predictive: pd.DataFrame
    bands: pd.DataFrame
    curvature: pd.DataFrame
    readings: pd.DataFrame
    draws: pd.DataFrame
    population: pd.DataFrame
    needles: pd.DataFrame

    @classmethod
    def of(cls, run: Run) -> Self:
        return cls(**{field.name: run.frames[field.name] for field in fields(cls)})

    @property
    def role(self) -> str:
        """The role that is scored: "validate", or "tune" for a fit without held-out insertions."""
        return "validate" if (self.errors["role"] == "validate").any() else "tune"

    @property
    def method(self) -> str:
        """The method whose errors are judged: our prediction, of a run without any the fit."""
        return PREDICTION_METHOD if (self.errors["method"] == PREDICTION_METHOD).any() else "fitted"

    @property
    def curved(self) -> bool:
        """Whether curves are compared, not tips alone: without one IPE means nothing."""
        return IPE.name in self.errors and bool(self.errors[IPE.name].notna().any())

    @property
    def free_parameters(self) -> pd.DataFrame:
        """The rows of the parameters that the fit estimated, of all folds."""
        return select_rows(self.parameters, method="fitted", status="free")

    def select_errors(self, **place: object) -> pd.DataFrame:
        """Return errors with layers where they were measured, of the role that is scored unless stated."""
        return select_rows(self.errors, **{"role": self.role, "boundaries": "measured", **place})

    def select_curves(self, **place: object) -> pd.DataFrame:
        """Return points of whole needles, none of tips, as of `select_errors`."""
        shapes = select_rows(self.shapes, **{"role": self.role, "boundaries": "measured", **place})
        return shapes[shapes.groupby("insertion")["j"].transform("max") > 1]


def list_methods() -> tuple[str, ...]:
    """Return the names of all methods in the order of tables: models, then baselines."""
    fitted, *others = MODEL_METHODS
    return (fitted, PREDICTION_METHOD, *others, *(baseline.name for baseline in list_baselines()))
