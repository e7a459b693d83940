"""The kinds of study, each a file or folder of `kinds/`: its study file, its computation, its report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

from needlefit.registry import Registry
from needlefit.schemas.base import FileRecord
from needlefit.schemas.run_metadata import RunMetadata


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
        parts = (self.load(part) for part in ("report", "run"))
        return next((part.FRAMES for part in parts if hasattr(part, "FRAMES")), {})

    def load(self, part: str) -> ModuleType:
        """Return the kind's module; of a package its part "run" or "report"."""
        module = import_module(self.package)
        return import_module(f"{self.package}.{part}") if hasattr(module, "__path__") else module

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
