"""The kinds of study, each a file or folder of `kinds/`: its study file, its computation, its report."""

import platform
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from needlefit.errors import NeedlefitError, UnfinishedWorkError
from needlefit.project.checkpoint import abandon_checkpoint, release_checkpoint
from needlefit.project.processes import one_thread
from needlefit.project.source_revision import find_source_revision
from needlefit.project.toml import add_study_context
from needlefit.registry import Registry
from needlefit.schemas.base import FileRecord
from needlefit.schemas.run_metadata import RunMetadata

if TYPE_CHECKING:  # these import this module
    from needlefit.studies.job import Settings
    from needlefit.studies.report import StudyReport
    from needlefit.studies.run import Run


@dataclass(frozen=True)
class StudyKind:
    """One kind of study."""

    name: str  #: the value of `kind` in the study file
    record: type[FileRecord]  #: the keys of the study file
    #: the module that has `run(name, record, settings)`, which returns a Run, a `StudyReport` named `REPORT`,
    #: and `FRAMES`, the columns that every frame of its runs has; or a package whose modules `run` and
    #: `report` do (either one the columns). They are imported on first use: to report a run, `report` alone
    package: str
    metadata: type[RunMetadata] = RunMetadata  #: what its runs know besides their frames

    @property
    def frames(self) -> Mapping[str, Sequence[str]]:
        """The columns that every frame of its runs has."""
        parts = (self._import(part) for part in ("report", "run"))
        return next((part.FRAMES for part in parts if hasattr(part, "FRAMES")), {})

    @property
    def report(self) -> "StudyReport":
        """How its results are reported."""
        report: StudyReport = self._import("report").REPORT
        return report

    def _import(self, part: str) -> ModuleType:
        """Return the kind's module, or the one of this name in its package."""
        module = import_module(self.package)
        return import_module(f"{self.package}.{part}") if hasattr(module, "__path__") else module

    @one_thread
    def run(self, name: str, record: FileRecord, settings: "Settings") -> "Run":
        """Run a study of this kind.

        The same record, data, seed and versions give the same frames for any number of jobs, and after an
        interruption with `resume`. A run that is complete still has the lock of its checkpoint: the caller
        writes the run, then removes or releases it.

        Raises ConfigError or DataError if anything the record names is missing or wrong.
        """
        begin, complete = time.time(), False
        try:
            with add_study_context(name):
                run = self.compute(name, record, settings)
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
        state: dict[str, Any] = {"interrupted": run.interrupted, "faults": list(map(str, run.faults))}
        if revision := find_source_revision():
            state["source_revision"] = revision
        return replace(run.with_metadata(**state), timing=timing | run.timing)

    def compute(self, name: str, record: FileRecord, settings: "Settings") -> "Run":
        """Run a study as a part of another one, which has the checkpoint and states the surroundings."""
        run: Run = self._import("run").run(name, record, settings)
        return run

    def make_record(self, **options: object) -> FileRecord:
        """Return the study file that the options of a command stand for."""
        return self.record.model_validate({"schema": self.record.SCHEMA, "kind": self.name, **options})


#: all kinds by name: the files and folders of `kinds/`, and those of plugins
KINDS = Registry(StudyKind, "needlefit.studies.kinds", "kind of study")


def kind_of(record: FileRecord) -> StudyKind:
    """Return the kind of a study file: its key `kind`, or for types without that key their `KIND`."""
    return find_kind(getattr(record, "kind", None) or getattr(record, "KIND", None))


def find_kind(name: object) -> StudyKind:
    """Return a kind by name; ConfigError if there is none."""
    if not isinstance(name, str) or name not in KINDS:
        raise KINDS.unknown_name_error(str(name), key="kind")
    return KINDS[name]


def list_records() -> dict[str, type[FileRecord]]:
    """Return the keys of the study files that a user writes, by kind."""
    return {name: KINDS[name].record for name in KINDS.names() if name != "reconstruction"}
