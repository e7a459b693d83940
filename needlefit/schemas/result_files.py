"""The forms of needlefit's own files, `run.json` and stored results; they are checked at every reading.

Only what later commands use is declared; other keys may stand beside it. That values are those that were
written the manifest states (`project.folders`).
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from needlefit.schemas.base import FileName
from needlefit.schemas.origin import Origin

ColumnType = Annotated[
    str, StringConstraints(pattern=r"^(u?int(8|16|32|64)|float(32|64)|bool|str|string|object)$")
]


class _StoredTable(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, protected_namespaces=())


class RunTable(_StoredTable):
    """The `run.json` of one run: what it was computed with."""

    kind: str = ""
    name: str = ""
    versions: dict[str, str] = {}
    dataset: dict[str, Any] | None = None


class TimingTable(_StoredTable):
    """The `timing.json` of one run."""

    seconds: float = Field(default=0.0, ge=0)
    jobs: int = 1
    dataset: str = ""
    folder: str = ""
    sources: list[str] = []


class FrameTable(_StoredTable):
    """A frame: the type and the cells of each column."""

    types: dict[str, ColumnType]
    columns: dict[str, list[str | int | float | bool | None]]


class FaultTable(_StoredTable):
    """A fault of a stored result."""

    kind: Literal["NOT_CONVERGED", "NOT_CERTIFIED"]
    what: str


class StoredRunTable(_StoredTable):
    """Stored results of a study of any kind."""

    kind: str
    name: FileName
    record: dict[str, Any]
    origin: Origin
    dataset_title: str
    interrupted: bool
    faults: list[FaultTable]
    run: dict[str, Any]
    frames: dict[FileName, FrameTable]
    posteriors: list[str]
