"""The result of a study: tables, draws, verdicts, and what a reader needs to repeat it."""

import gzip
import json
import os
import zlib
from collections.abc import Callable, Hashable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import Any, Concatenate, NamedTuple, ParamSpec, Self, TypeVar

import pandas as pd
from pydantic import BaseModel, ValidationError

from needlefit.datasets.sources import DATASET_FILE, DatasetFiles
from needlefit.errors import ConfigError, DataError
from needlefit.inference.baselines import list_baselines
from needlefit.inference.parameter_names import BEVEL_SPREAD, find_bevel_factors
from needlefit.inference.parameters import Parameters
from needlefit.inference.sampling.posterior import Posterior, load, save
from needlefit.metrics import IPE
from needlefit.project.folders import TIMING_FILE, require_unchanged
from needlefit.project.input_files import (
    MAX_TEXT_BYTES,
    convert_stored_errors,
    is_file,
    open_regular,
    parse_json,
    read_json,
    to_json_values,
)
from needlefit.project.locate import file_label, find_file, read_toml, unknown_name_error
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning, condense_open_points
from needlefit.project.toml import add_key_context
from needlefit.reporting.table_files import select_rows
from needlefit.schemas.base import FileRecord
from needlefit.schemas.origin import ORIGIN_MARKS, ORIGIN_NOTES, Origin
from needlefit.schemas.run_metadata import FitMetadata, RunMetadata, RunTable, StoredRunTable, TimingTable
from needlefit.schemas.study import FitRecord
from needlefit.studies.first_page import STATUSES, FaultKind, FirstPage, RunFault, Verdict, list_doubts
from needlefit.studies.kind import KINDS, find_kind

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

#: words in place of a specimen's name: those that were tuned on, together, and one that is not in the dataset
TUNED_SPECIMENS, NEW_SPECIMEN = "(tuned)", "(new)"

#: name of our prediction as a method: the needle of the posterior mode, through the layers that it meets
#: itself, or the median needle
PREDICTION_METHOD = "prediction"
#: methods that simulate a needle: both fits, b fitted alone with the others as they are before any data, and
#: the paper's parameters
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


# ---- its storage, exact to the last digit; equal results give equal bytes
#
# `results.json.gz` holds the record and the tables as JSON; posteriors lie beside it.
# What is read must agree with the manifest of the folder (`project.folders`).

RESULTS_FILE, RUN_FILE = "results.json.gz", "run.json"
Form = TypeVar("Form", bound=BaseModel)
DATA_FOLDER = "dataset"  #: folder of a copy of the data that were fitted to

FORMAT_VERSION = 10  #: version of the format of the file of results
#: largest size of the text in the file (bytes); the studies of the paper have some MB
MAX_UNPACKED_BYTES = 256 * 2**20
#: largest size of the data that are copied (bytes); the synthetic dataset has 0.8 MB
MAX_DATA_BYTES = 64 * 2**20
#: largest size of a `run.json` (bytes); those of several studies together have some hundred kB
MAX_RUN_BYTES = 32 * 2**20

_PLAIN = ("kind", "name", "origin", "dataset_title", "interrupted")


def store_run(run: Run, folder: Path) -> Path:
    """Write a result without its times to `folder`, and a copy of its data; return the file of results."""
    files = posterior_file_names(len(run.posteriors))
    for posterior, file in zip(run.posteriors.values(), files, strict=True):
        save(posterior, folder / file)
    table = {
        "posteriors": list(run.posteriors),
        "record": run.record.model_dump(mode="json", by_alias=True),
        **{key: getattr(run, key) for key in _PLAIN},
        "run": to_json_values(run.metadata.to_json()),
        "faults": [{"kind": fault.kind.name, "what": fault.what} for fault in run.faults],
        "frames": {name: _pack_frame(frame) for name, frame in run.frames.items()},
    }
    stated = run.metadata.dataset
    if run.data is not None and stated is not None and _can_be_kept(run.data, stated.sha256):
        run.data.copy_to(folder / DATA_FOLDER)
    return pack(table, folder)


def _can_be_kept(data: DatasetFiles, digest: str) -> bool:
    """Return whether data are small enough to be copied, and still those with the digest."""
    try:
        return data.can_be_copied and data.size <= MAX_DATA_BYTES and data.digest() == digest
    except OSError:  # a file is gone
        return False


def posterior_file_names(count: int) -> tuple[str, ...]:
    """Return the names of the posterior files of a run, in the order of its posteriors."""
    return ("posterior.nc",) if count == 1 else tuple(f"posterior_{k + 1}.nc" for k in range(count))


def restore_run(folder: Path) -> Run:
    """Read the result that a run stored in `folder`.

    Raises DataError if it holds no result, a damaged one, or one that does not agree with its manifest.
    """
    table = unpack(folder)
    require_unchanged(folder)
    require_schema(table, StoredRunTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        if table["kind"] not in KINDS:
            raise damage_error(folder / RESULTS_FILE, f"there is no kind of study called {table['kind']!r}")
        kind = find_kind(table["kind"])
        faults = [RunFault(FaultKind[fault["kind"]], fault["what"]) for fault in table["faults"]]
        frames: Frames = {name: _unpack_frame(frame) for name, frame in table["frames"].items()}
        for name, wanted in kind.frames.items():
            frame = frames.setdefault(name, pd.DataFrame(columns=list(wanted)))  # one of a later version
            if lacking := [column for column in wanted if column not in frame]:
                raise DataError(
                    f"run `{table['name']}` lacks the column {', '.join(lacking)} in its table {name}",
                    expected="a run of this version",
                    fix="run it again, or read it with the version that wrote it",
                    where=folder,
                )
        names, copy = table["posteriors"], folder / DATA_FOLDER
        files = posterior_file_names(len(names))
        return Run(
            record=kind.record.model_validate(table["record"]),
            frames=frames,
            metadata=require_schema(table["run"], kind.metadata, str(folder / RESULTS_FILE)),
            timing=read_timing(folder),
            posteriors={name: load(folder / file) for name, file in zip(names, files, strict=True)},
            faults=tuple(faults),
            data=DatasetFiles.of_copy(copy) if is_file(copy / DATASET_FILE) else None,
            **{key: table[key] for key in _PLAIN},
        )


def read_run(folder: Path) -> dict[str, Any]:
    """Return what the run in a folder was computed with.

    Raises DataError if its file is missing or damaged, or a value in it is of another type than needlefit
    writes.
    """
    return _read_table(folder / RUN_FILE, RunTable)


def read_timing(folder: Path) -> dict[str, Any]:
    """Return times and durations of a run, empty if it has no `timing.json`; DataError if that is damaged."""
    path = folder / TIMING_FILE
    return _read_table(path, TimingTable) if is_file(path) else {}


def _read_table(path: Path, form: type[BaseModel]) -> dict[str, Any]:
    table = read_json(path, MAX_RUN_BYTES)
    require_schema(table, form, str(path))
    return dict(table)


def require_schema(table: object, form: type[Form], where: str) -> Form:
    """Return a table read from a file in its declared form; DataError names the first key at fault."""
    try:
        return form.model_validate(table)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False, include_context=False)[0]
        key = ".".join(f"{part!s:.40}" for part in fault["loc"][:6])
        raise DataError(
            f"is damaged: {fault['msg'][:200]}",
            where=f"{where}, key `{key}`" if key else where,
            expected="what needlefit wrote there",
            fix="run it again",
        ) from None


# --- the file of results --------------------------------------------------------------------------------


def pack(table: Mapping[str, Any], folder: Path) -> Path:
    """Write a table of JSON values and arrays to `folder`."""
    path = folder / RESULTS_FILE
    text = json.dumps(
        {"format": FORMAT_VERSION, **table}, ensure_ascii=False, default=lambda value: value.tolist()
    )
    path.write_bytes(gzip.compress(text.encode("utf-8"), 4, mtime=0))  # 6 takes three times as long for 2 %
    return path


def unpack(folder: Path) -> dict[str, Any]:
    """Read the table that a run stored in `folder`; it is not compared with the manifest.

    Raises DataError if it holds none, or one that is damaged, too large or of another version.
    """
    path = folder / RESULTS_FILE
    if not is_file(path):
        raise DataError(
            "holds no stored results",
            where=folder,
            expected=f"{RESULTS_FILE}, which needlefit writes into each run",
            fix="name the folder of a run",
        )
    try:
        with open_regular(path, MAX_TEXT_BYTES) as file, gzip.GzipFile(fileobj=file) as unzipped:
            text = unzipped.read(MAX_UNPACKED_BYTES + 1).decode("utf-8")
    except (EOFError, OSError, UnicodeDecodeError, zlib.error):
        raise damage_error(path, "it is no complete gzip file of text") from None
    if len(text) > MAX_UNPACKED_BYTES:
        raise damage_error(path, f"it unpacks to more than {MAX_UNPACKED_BYTES / 2**20:.0f} MiB")
    table = parse_json(text, str(path))
    if not isinstance(table, dict) or table.get("format") != FORMAT_VERSION:
        raise DataError(
            "is of a format that this version cannot read",
            where=path,
            expected=f"format {FORMAT_VERSION}",
            fix="read it with the version that wrote it, or run it again",
        )
    return table


def damage_error(path: Path, why: str) -> DataError:
    """Return the error for a file of a result that does not hold what it should."""
    return DataError(
        f"is damaged: {why}",
        where=path,
        expected="the file as needlefit wrote it",
        fix="run it again",
    )


def _pack_frame(frame: pd.DataFrame) -> dict[str, Any]:
    columns = {str(name): frame[name].tolist() for name in frame}
    return {"types": {name: str(frame[name].dtype) for name in columns}, "columns": columns}


def _unpack_frame(table: Mapping[str, Any]) -> pd.DataFrame:
    columns = table["columns"]
    if len(set(map(len, columns.values()))) > 1 or columns.keys() != table["types"].keys():
        raise ValueError("columns are of different lengths, or without types")
    return pd.DataFrame(
        {name: pd.Series(columns[name], dtype=kind) for name, kind in table["types"].items()},
        columns=list(columns),
    )


# --- of which files a result is made: that of another study or dataset is not replaced
#
# Two studies may have one name, and results of one name lie in one folder. `timing.json` names the files:
# shipped ones by their names, others by their paths from the folder of the result, so that a project can be
# moved.

SOURCES_KEY = "sources"  #: key of the sources in `timing.json`


def name_source(file: Path) -> str:
    """Return the name of a shipped file, the absolute path of another one."""
    label = file_label(file)
    return str(file.resolve()) if label == str(file) else label


def store_sources(sources: Sequence[str], folder: Path) -> dict[str, list[str]]:
    """Return the entry of `timing.json` for a result in `folder` that is made of these files."""
    return {SOURCES_KEY: [_relate(source, folder) for source in sources]}


def read_sources(timing: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the files of which the result in `folder` was made; none of earlier versions."""
    return [
        str((folder / source).resolve()) if source.startswith(".") else source
        for source in timing.get(SOURCES_KEY, ())
    ]


def require_same_sources(folder: Path, sources: Sequence[str], record: FileRecord | None = None) -> None:
    """Raise ConfigError if a folder holds the result of other files, or of another dataset than a fit names.

    Results of earlier versions name no files.
    """
    if not is_file(folder / RUN_FILE):
        return
    try:
        run, timing = read_run(folder), read_timing(folder)
    except DataError:  # a damaged one is no result to be lost
        return
    for before, after in zip(read_sources(timing, folder), sources, strict=False):
        if before != after:
            raise _other_result_error(folder, before, after)
    if isinstance(record, FitRecord) and (dataset := run.get("dataset")):
        with add_key_context("dataset"):
            before, after = dataset["name"], read_toml(find_file("dataset", record.dataset)).get("name", "")
        if before != after:
            raise _other_result_error(folder, f"the dataset {before}", f"the dataset {after}")


def _relate(source: str, folder: Path) -> str:
    """Return a path as it is from a folder, beginning with a dot; a name as it is."""
    if not Path(source).is_absolute():
        return source
    try:
        related = Path(os.path.relpath(source, folder.resolve())).as_posix()
    except ValueError:  # on another drive
        return source
    return related if related.startswith(".") else f"./{related}"


def _other_result_error(folder: Path, before: str, after: str) -> ConfigError:
    return ConfigError(
        f"holds another result, of {before}",
        where=folder,
        expected=f"a new folder, or the result of {after}",
        fix="choose another folder with --out, or move that result away",
    )


# ---- draws of its parameters for one further insertion: in which specimen it is, and with which bevel


class InsertionDraws(NamedTuple):
    """Draws of all parameters (Pa, mm, degrees), each with a bevel of its own; None where not certified."""

    specimen: str  #: in which they are, by its name in the table of draws
    table: pd.DataFrame | None


def draw_insertion(
    run: Run,
    fold: str,
    name: str,
    specimen: str,
    chosen: str = "shown",
    find_bevel_sd: Callable[[bool], float] | None = None,
) -> InsertionDraws:
    """Return the draws of a fold for the insertion `name` into a specimen; `chosen`: of a `ViewTarget`.

    `find_bevel_sd`: by how many SDs its bevel deviates, in a new specimen or a known one; by default as the
    run states. ConfigError if there is no specimen of that name.
    """
    stated = run.knows(FitMetadata)
    (tune,) = (one.tune for one in stated.folds if one.name == fold)
    specimens = dict(zip(*(run.frames["errors"][key] for key in ("insertion", "specimen")), strict=True))
    drawn = _choose_specimen(run, specimen, {specimens[one] for one in tune if one in specimens}, chosen)
    draws = select_rows(run.frames["draws"], fold=fold, specimen=drawn)
    if draws.empty or not draws["certified"].all():
        return InsertionDraws(drawn, None)
    sd = find_bevel_sd(drawn == NEW_SPECIMEN) if find_bevel_sd else stated.new_bevel_sd[fold]
    names = [key for key in (*Parameters.from_record(stated.medium).names, BEVEL_SPREAD) if key in draws]
    varied = draws[names].astype(float)
    spreads = varied[BEVEL_SPREAD].to_numpy() if BEVEL_SPREAD in names else 0.0
    deviations = sd * random_stream(stated.recipe.seed, "band", name).standard_normal(len(varied))
    varied[stated.medium.bevel_parameter] *= find_bevel_factors(spreads, deviations)
    return InsertionDraws(drawn, varied)


def _choose_specimen(run: Run, specimen: str, tuned: set[str], chosen: str) -> str:
    """Return in which specimen the draws for an insertion are, by its name in the table of draws."""
    names = {*run.frames["draws"]["specimen"]} - {NEW_SPECIMEN, TUNED_SPECIMENS}
    if chosen not in ("shown", "planned", "new", "same"):
        if chosen not in names & tuned:
            raise unknown_name_error("specimen", chosen, ["new", "same", *(names & tuned)], "")
        return chosen
    differ = run.record.specimens == "others"
    if chosen == "new" or (differ and (chosen == "planned" or specimen not in tuned)):
        return NEW_SPECIMEN if chosen != "same" else TUNED_SPECIMENS
    return specimen if specimen in names else TUNED_SPECIMENS
