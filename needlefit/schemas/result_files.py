"""The forms of needlefit's own files, `run.json` and stored results; they are checked at every reading.

Only what later commands use is declared; other keys may stand beside it. Every key of a `run.json` is
optional, since each command writes its own.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from needlefit.schemas.base import FileName

ColumnType = Annotated[
    str, StringConstraints(pattern=r"^(u?int(8|16|32|64)|float(32|64)|bool|str|string|object)$")
]
_SCALARS: frozenset[type] = frozenset({str, int, float, bool, type(None)})
#: Types of JSON that a column may hold; pandas would take any for them. A missing text is NaN or None.
_CELLS: dict[str, frozenset[type]] = {
    "bool": frozenset({bool}),
    "str": frozenset({str, float, type(None)}),
}

Cell = str | int | float | bool | None


class _StoredTable(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, protected_namespaces=())


class _DatasetTable(_StoredTable):
    name: str = ""
    origin: str = ""
    sha256: str = ""
    needle: dict[str, Cell] | None = None
    notes: list[str] = []


class _FoldTable(_StoredTable):
    name: str
    tune: list[str]
    validate_: list[str] = Field(default=[], alias="validate")


class _StudyTable(_StoredTable):
    """What a run was asked for, as far as others look for it by that."""

    kind: str | None = None
    studies: list[str] = []
    fits: list[str] | list[dict[str, Any]] = []


class _WarningTable(_StoredTable):
    model_config = ConfigDict(extra="forbid")

    kind: str
    what: str
    where: str = ""
    fix: str = ""


class _SimulationCount(_StoredTable):
    simulations: int = 0
    outside: int = 0


class _ValidityTable(_StoredTable):
    """How many simulations are outside what the model assumes."""

    scored: _SimulationCount = _SimulationCount()
    starts: _SimulationCount = _SimulationCount()
    draws: _SimulationCount = _SimulationCount()
    predicted: _SimulationCount = _SimulationCount()
    fitted_outside: int = 0


class RunTable(_StoredTable):
    """The `run.json` of one run: what it was computed with."""

    kind: str = ""
    name: str = ""
    versions: dict[str, str] = {}
    dataset: _DatasetTable | None = None
    datasets: dict[str, _DatasetTable] = {}
    study: _StudyTable | None = None
    medium: dict[str, Any] | None = None
    recipe: dict[str, Any] | None = None
    folds: list[_FoldTable] = []
    rules: dict[str, Cell] = {}
    search_faults: dict[str, list[str]] = {}
    faults: list[str] = []
    unverified: list[str] = []
    warnings: list[_WarningTable] = []
    validity: _ValidityTable = _ValidityTable()
    parts: list["RunTable"] = []
    replicates: int = 0
    not_calibrated: list[str] = []


class TimingTable(_StoredTable):
    """The `timing.json` of one run."""

    seconds: float = Field(default=0.0, ge=0)
    jobs: int = 1


class FrameTable(_StoredTable):
    """A frame: the type and the cells of each column."""

    types: dict[str, ColumnType]
    columns: dict[str, list[Any]]

    @model_validator(mode="after")
    def _rectangular(self) -> Self:
        if self.types.keys() != self.columns.keys():
            raise ValueError("types and columns are not of the same names")
        if len({len(cells) for cells in self.columns.values()}) > 1:
            raise ValueError("columns are of different lengths")
        for name, cells in self.columns.items():
            found = {type(cell) for cell in cells}
            if not found <= _CELLS.get(self.types[name], _SCALARS):
                raise ValueError(f"a cell of column {name} is not of its type, {self.types[name]}")
        return self


class FaultTable(BaseModel):
    """A fault of a stored result."""

    kind: Literal["NOT_CONVERGED", "NOT_CERTIFIED", "INCOMPLETE", "UNVERIFIED"]
    what: str


class StoredRunTable(_StoredTable):
    """Stored results of a study of any kind."""

    kind: str
    name: FileName
    record: dict[str, Any]
    origin: Literal["measured", "synthetic"]
    dataset_title: str
    interrupted: bool
    faults: list[FaultTable]
    run: RunTable
    frames: dict[FileName, FrameTable]
    posteriors: list[str]
