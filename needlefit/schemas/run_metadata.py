"""What a run knows besides its tables: all that decides its result, and what it found as a whole.

`run.json` and the stored results hold these records. Paths and times are in `timing.json`. A key that a run
does not state is left out.
"""

from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    StringConstraints,
    model_serializer,
)

from needlefit.schemas.base import Compared, FileName
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.origin import Origin
from needlefit.schemas.recipe import RecipeRecord

Table = dict[str, Any]  #: what is stored for a reader alone
Other = TypeVar("Other", bound="RunMetadata")


class _Metadata(BaseModel):
    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        populate_by_name=True,
        protected_namespaces=(),
        defer_build=True,
    )

    @model_serializer(mode="wrap")
    def _leave_out_unset(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the keys that were stated."""
        fields = type(self).model_fields
        stated = {fields[name].alias or name for name in self.model_fields_set}
        return {key: value for key, value in serialize(self).items() if key in stated}


# ---- parts


class WarningMetadata(_Metadata):
    """A warning about data, study or result; `where` is a file by its name alone."""

    kind: str
    what: str
    where: str = ""
    fix: str = ""
    insertions: tuple[str, ...] = ()


class NeedleMetadata(_Metadata):
    """A needle: lengths in mm, EI in N mm^2, and of several how many insertions it has."""

    outer_diameter: float | None = None
    flexural_rigidity: float
    length: float
    insertions: int = 1


class RigidityMetadata(_Metadata):
    """The flexural rigidity of a needle, and where it is from."""

    nmm2: float
    origin: str


class DatasetMetadata(_Metadata):
    """The data: a digest, what their measurement does to shapes, and which errors they share."""

    name: str
    origin: str
    sha256: str
    notes: list[str]
    measurement: Table
    boundary_shared_sd_mm: list[float]
    rigidity: dict[str, RigidityMetadata]
    needle: NeedleMetadata | None = None  #: of all insertions; where they differ `needles`, by name
    needles: dict[str, NeedleMetadata] | None = None


class FoldMetadata(_Metadata):
    """The ids of the insertions of a fold: of those fitted to, and of those held out."""

    name: str
    tune: list[str]
    held_out: list[str] = Field(alias="validate")


class FitIdentity(_Metadata):
    """What a result was made of, as digests; equal ones are of the same fit, or the same study."""

    sha256: str  #: of all that decides the result; this is what is compared
    parts: dict[str, str]  #: of each part of that, to name those that differ
    insertions: dict[str, str]  #: of the data of each insertion, by its id


class InsertionMetadata(_Metadata):
    """How an insertion was made: what its simulation needs besides needle and layers, lengths in mm."""

    depth: float
    side: int
    bevel_factor: float
    guide_distance: float | None
    base_moved: float
    compared: float | None  #: length from the tip that is compared, of a shape of unknown pose
    specimen: str
    turns: tuple[tuple[float, float], ...] = ()
    needle: str = ""  #: its name, where there are several
    observations: tuple[str, ...] = ()  #: by what it was measured, if by more than one


class CountMetadata(_Metadata):
    """A number of simulations, and how many of them are outside what the model assumes."""

    simulations: int = 0
    outside: int = 0


class ValidityMetadata(_Metadata):
    """How many simulations of each kind were outside what the model assumes, and its limits."""

    draws: CountMetadata
    predicted: CountMetadata
    limits: dict[str, float]
    fitted_outside: int  #: scored simulations of the fits


class DepthMetadata(_Metadata):
    """Whether the data would show a boundary at another depth than stated, and which modulus leans on it."""

    boundary: int
    sd_mm: float  #: to which the data know a shift of it
    stated_sd_mm: float
    parameter: str
    factor_per_mm: float  #: of this parameter


class DoubtMetadata(_Metadata):
    """A needle that the fit to the others does not predict, or all alike: what may have happened."""

    insertion: str = ""  #: empty of all alike
    place: str = ""  #: file and line of its row
    sds: float = 0.0  #: its distance from the prediction, in standard deviations
    log_odds: float = 0.0  #: that something happened to it, of a table of hypotheses
    cause: str = ""  #: a key of `HYPOTHESES` in `inference/hypotheses.py`; empty where none explains it
    aside: bool = False  #: whether out of the plane of its bevel
    #: the number that was fitted: a factor, mm or degrees; of all toward +y or +z of their frames, or deeper
    size: float | None = None
    sd: float | None = None  #: of it; of a factor, of its logarithm
    where: str = ""  #: the number of the point or boundary, or the other needle, by this cause
    stated: float | None = None  #: depth of the boundary, mm
    #: along the entry, and deflections toward the bevel as measured and as the others predict them, mm
    points: list[tuple[float, float, float]] = []


class EffectMetadata(_Metadata):
    """What a study finds without the needles that are in doubt: contradictory, or not predicted by others."""

    insertions: list[str]
    outcome: str  #: without them
    turns: bool  #: whether it is another than with them
    #: by parameter its value with them and without them, Pa and mm; of the first fit
    values: dict[str, tuple[float, float]]


class MedianMetadata(_Metadata):
    """An insertion whose prediction is the predictive median, and why it is not the mode (`choose_point`)."""

    fold: str
    insertion: str
    mode_fault: str
    at_bound: dict[str, str]  #: by symbol of a parameter the bound at which it lies, in words


# ---- runs


class RunMetadata(_Metadata):
    """What every run knows; runs of a kind may know more."""

    name: str
    versions: dict[str, str] = {}  #: of Python, needlefit and the packages that decide the result
    study: Table = {}  #: the study file
    identity: FitIdentity | None = None  #: None of what fits nothing
    dataset: DatasetMetadata | None = None
    medium: MediumRecord | None = None
    recipe: RecipeRecord | None = None
    folds: list[FoldMetadata] = []
    warnings: list[WarningMetadata] = []
    interrupted: bool = False
    faults: list[str] = []
    source_revision: str = ""  #: of a working copy

    @property
    def work(self) -> dict[str, Any]:
        """What decides the rows that a checkpoint keeps: the identity, and the versions that compute."""
        return {"identity": self.identity and self.identity.sha256, "versions": self.versions}

    def state(self, **more: Any) -> Self:  # noqa: ANN401 - as pydantic's
        """Return what also states these keys."""
        return self.extend(type(self), **more)

    def to_json(self) -> dict[str, Any]:
        """Return all that is stated, as JSON values."""
        return self.model_dump(mode="json", by_alias=True)

    def extend(self, kind: type[Other], **more: Any) -> Other:  # noqa: ANN401 - as pydantic's
        """Return what runs of a kind know: all that is stated here, and more."""
        stated = {name: getattr(self, name) for name in self.model_fields_set}
        return kind.model_validate({**stated, **more})


class JobMetadata(RunMetadata):
    """What a run of a fit knows: everything that decides it."""

    dataset: DatasetMetadata
    medium: MediumRecord
    recipe: RecipeRecord
    hand_tuned: dict[str, float] | None
    rules: Table  #: of the model; fits with other rules cannot be compared
    compared: Compared


class FitMetadata(JobMetadata):
    """What a fit or cross-validation knows."""

    layers: dict[str, list[tuple[int, float]]]  #: by insertion those it meets, and where each begins, mm
    insertions: dict[str, InsertionMetadata]
    new_bevel_sd: dict[str, float]  #: by fold: by how many SDs the bevel of a further insertion deviates
    search_faults: dict[str, list[str]]  #: by fold: why the best point may not be the best
    stated_depths: list[DepthMetadata] = []
    odd_needles: list[DoubtMetadata] = []
    effect: EffectMetadata | None = None  #: of the odd needles
    #: how many of how many needles the others do not predict, where the model does not fit
    deviating: tuple[int, int] | None = None
    common_doubt: DoubtMetadata | None = None
    unjudged: str = ""  #: why no needle was compared with the others: as of `Doubts`
    medians: list[MedianMetadata] = []
    #: of shapes of unknown pose: by parameter the factor between the ends of its 95 % interval if the
    #: directions of insertion were stated
    with_direction: dict[str, float] = {}
    validity: ValidityMetadata


class AnalysisMetadata(JobMetadata):
    """What an analysis of a fit knows: its own study file, and that of the fit."""

    fit: Table


class IdentificationMetadata(AnalysisMetadata):
    """What an identification knows."""

    place: str  #: where the reference values are from
    values: dict[str, float]
    insertions: int
    depths_mm: list[float]


class PredictionMetadata(AnalysisMetadata):
    """What a prediction knows: how its draws were made, and what was found of the fit."""

    draw_source: str
    pareto_k: float | None
    ess: float | None
    draws: int
    specimen: str
    fit_verdict: str | None
    fit_run: str | None
    fit_changed: str
    fit_advice: Table | None
    held_out_by_target: bool
    failed_solves: int
    outside_validity: int
    not_converged: list[str]
    mode: dict[str, float] | None = None  #: parameters of the posterior mode
    mode_fault: str = "none"  #: why the predictive median is reported in its place (`choose_point`)
    at_bound: dict[str, str] = {}  #: as of `MedianMetadata`
    #: where the median is reported, parameters of the draw whose tip is nearest to it
    nearest: dict[str, float] | None = None
    drawn: dict[str, list[float]] | None = None  #: parameters of certified draws, evenly chosen, for its page


# ---- the forms of `run.json`, `timing.json` and stored results, which are checked at every reading
#
# Only what later commands use is declared; other keys may stand beside it. That values are those that were
# written the manifest states (`project.folders`).

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
