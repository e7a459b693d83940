"""Check a study or fit before it runs: its keys, and all that it names."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from needlefit.project.locate import FileKind, find_file
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import add_file_context, add_key_context, load
from needlefit.schemas.base import FileRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.job import Settings, prepare
from needlefit.studies.study_files import load_study
from needlefit.studies.targets import load_target

_NAMED_FILES: Mapping[str, FileKind] = {
    **{"dataset": "dataset", "medium": "medium", "recipe": "recipe"},
    **{"fits": "fit", "studies": "study"},
}
"""Keys of study files whose values name files of a kind, alone or in a list."""


@dataclass(frozen=True)
class StudyCheck:
    """A study without faults.

    Attributes
    ----------
    kind : str
        "fit", "cross-validation", or the kind that the file states.
    folds : tuple of (int, int)
        Insertions fitted to and held out, in each fold; empty of other kinds.
    warnings : tuple of ResultWarning
        About the data and the study.
    """

    kind: str
    folds: tuple[tuple[int, int], ...] = ()
    warnings: tuple[ResultWarning, ...] = ()


def check_study_file(kind: Literal["study", "fit"], path: Path) -> StudyCheck:
    """Check a study or fit and everything that it names, without a simulation.

    Of a fit or a cross-validation all its data are read; of other kinds the files named must exist.

    Raises ConfigError, DataError if anything in it is missing or wrong.
    """
    record: FileRecord = load(path, FitRecord) if kind == "fit" else load_study(path)
    with add_file_context(path):
        if not isinstance(record, FitRecord):
            _find_files(record.model_dump(mode="json", by_alias=True))
            return StudyCheck(str(getattr(record, "kind", "tip tracks")))
        job = prepare(path.stem, record, Settings(file=path))
    folds = tuple((len(fold.tune), len(fold.validate)) for fold in job.folds)
    return StudyCheck("cross-validation" if isinstance(record, StudyRecord) else "fit", folds, job.warnings)


def _find_files(table: Mapping[str, object]) -> None:
    """Find all files that a table of a study names, and those of the tables within it."""
    for key, value in table.items():
        with add_key_context(key):
            for name in _list_names(value):
                if key in _NAMED_FILES:
                    find_file(_NAMED_FILES[key], name)
                elif key == "target":
                    load_target(name)
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, Mapping):
                _find_files(inner)


def _list_names(value: object) -> Iterator[str]:
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, str):
            yield one
