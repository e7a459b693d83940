"""The result of a study: tables, provenance, and the file that stores them."""

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.inference.sampling.posterior import Posterior, load, save
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.run_file import read_timing, require_schema
from needlefit.schemas.result_files import StoredRunTable
from needlefit.studies.columnar import ColumnarFrames, list_columns, open_files, store_files
from needlefit.studies.kind import KINDS, find_kind
from needlefit.studies.packing import RESULTS_FILE, damage_error, pack, pack_frame, unpack, unpack_frame
from needlefit.studies.verdict import Verdict, judge_run

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
    origin : "measured", "synthetic" or "none"
        Synthetic as soon as anything in it is; none where it has no data.
    dataset_title : str
        The data, in words.
    frames : mapping of DataFrame
        One row a fact, the unit in every column's name. Those of `ColumnarFrames` are in files.
    run : dict
        All that decides the result (versions, data, configuration, rules); no time and no path.
    timing : dict
        Seconds, jobs, paths.
    interrupted : bool
        Whether some of the work was left undone.
    faults : tuple of str
        Why something in it is not to be trusted.
    posteriors : mapping
        Sampled posteriors, by name of the fit or fold.
    """

    kind: str
    name: str
    record: Any = field(repr=False)
    origin: Literal["measured", "synthetic", "none"]
    dataset_title: str
    frames: Mapping[str, pd.DataFrame] = field(repr=False)
    run: dict[str, Any] = field(repr=False)
    timing: dict[str, Any] = field(repr=False)
    interrupted: bool = False
    faults: tuple[str, ...] = ()
    posteriors: Mapping[str, Posterior] = field(default_factory=dict, repr=False)

    @property
    def run_json(self) -> dict[str, Any]:
        """What `run.json` holds: the kind, and all that decides the result."""
        return {"kind": self.kind, **self.run}

    def with_frames(self, **frames: pd.DataFrame) -> Self:
        """Return the run with some tables replaced."""
        return replace(self, frames={**self.frames, **frames})

    @property
    def title(self) -> str:
        """The title of the report."""
        return str(getattr(self.record, "title", "") or self.name)

    @property
    def question(self) -> str:
        """What the study asks."""
        return str(getattr(self.record, "question", ""))

    @property
    def note(self) -> str:
        """What a reader of the study must know."""
        return str(getattr(self.record, "note", ""))

    @property
    def synthetic(self) -> bool:
        """Whether anything in it is synthetic."""
        return self.origin == "synthetic"

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

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The answer in one sentence for each group, with its status and numbers."""
        return judge_run(self)

    def save(self, folder: Path | str) -> Path:
        """Write tables (CSV, LaTeX), figures, report and all that `load_run` reads to `folder`; return it.

        Raises
        ------
        ConfigError
            If `folder` holds anything that needlefit did not write, or that was changed since.
        """
        return find_kind(self.kind).report.write(self, Path(folder))

    def _repr_html_(self) -> str:
        return find_kind(self.kind).report.format_notebook_html(self)


_PLAIN = ("kind", "name", "origin", "dataset_title", "interrupted", "faults", "run")


def store_run(result: Run, folder: Path) -> Path:
    """Write a result without its times to `folder`; equal results give equal bytes.

    Posteriors and the frames of files stay in files of their own beside it.
    """
    files = posterior_file_names(len(result.posteriors))
    for posterior, file in zip(result.posteriors.values(), files, strict=True):
        save(posterior, folder / file)
    columnar = store_files(result.frames, folder)
    table = {
        "posteriors": list(result.posteriors),
        "record": result.record.model_dump(mode="json", by_alias=True),
        **{key: to_json_values(getattr(result, key)) for key in _PLAIN},
        "frames": {name: pack_frame(result.frames[name]) for name in result.frames if name not in columnar},
        **({"columnar": columnar} if columnar else {}),
    }
    return pack(table, folder)


def posterior_file_names(count: int) -> tuple[str, ...]:
    """Return the names of the posterior files of a run, in the order of its posteriors."""
    return ("posterior.nc",) if count == 1 else tuple(f"posterior_{k + 1}.nc" for k in range(count))


def restore_run(folder: Path) -> Run:
    """Read the result that a run stored in `folder`; DataError if it holds none, or a damaged one."""
    table = unpack(folder)
    require_schema(table, StoredRunTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        if table["kind"] not in KINDS:
            raise damage_error(folder / RESULTS_FILE, f"there is no kind of study called {table['kind']!r}")
        kind = find_kind(table["kind"])
        about: dict[str, Any] = {key: table[key] for key in _PLAIN}
        frames: Frames = {name: unpack_frame(frame) for name, frame in table["frames"].items()}
        if columnar := open_files(folder, table.get("columnar", {})):
            frames = ColumnarFrames({**frames, **columnar})
        _require_columns(frames, kind.frames)
        names = table["posteriors"]
        files = posterior_file_names(len(names))
        return Run(
            record=kind.record.model_validate(table["record"]),
            frames=frames,
            timing=read_timing(folder),
            posteriors={name: load(folder / file) for name, file in zip(names, files, strict=True)},
            **{**about, "faults": tuple(about["faults"])},
        )


def _require_columns(frames: Frames, columns: Mapping[str, Sequence[str]]) -> None:
    for name, wanted in columns.items():
        found = list_columns(frames, name) if name in frames else []
        missing = [column for column in wanted if column not in found]
        if missing:
            raise ValueError(f"the table {name} lacks {', '.join(missing)}")
