"""Which keys of files decide the numbers of a fit: all but those that are listed here."""

from collections.abc import Collection, Mapping
from typing import Any

from pydantic import BaseModel

from needlefit.schemas.analyses import QuestionRecord
from needlefit.schemas.base import FileRecord
from needlefit.schemas.dataset import (
    DatasetMediumRecord,
    DatasetRecord,
    FrameRecord,
    MeasurementRecord,
    NoiseRecord,
    SourceRecord,
    TrackDatasetRecord,
    TrackMediumRecord,
)
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.scene import NeedleRecord, SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord

_WORDS = {"note": "free text"}
_HEADS = {"title": "heading of reports", **_WORDS}
_CHECKED = {
    "import_": "how the values were found; the values decide",
    "checksums": "only compared with the files",
}

#: by the table in which they stand, keys that decide no number, and why; they count in its subclasses too
UNDECIDING: Mapping[type[BaseModel], Mapping[str, str]] = {
    FileRecord: {"schema_": "layout of the file"},
    FitRecord: {**_HEADS, "margin_for": "words beside `margin_mm`"},
    StudyRecord: {
        "question": "printed at the head of reports",
        "paper_study": "the paper's numbers, printed beside ours",
    },
    QuestionRecord: {**_HEADS, "question": "printed at the head of reports"},
    MediumRecord: _HEADS,
    RecipeRecord: {"title": "free text", "preliminary": "label of verdicts"},
    SceneRecord: _HEADS,
    NeedleRecord: _WORDS,
    SourceRecord: {
        "name": "label of the data",
        "title": "heading of reports",
        "license": "free text",
        "source": "free text",
        "how_to_get": "free text",
        "notes": "free text",
        "truth_seed": "true parameters, which no fit knows",
        "truth": "true parameters, which no fit knows",
    },
    DatasetRecord: _CHECKED,
    TrackDatasetRecord: _CHECKED,
    FrameRecord: {"name": "label of the coordinates"},
    NoiseRecord: _WORDS,
    MeasurementRecord: _WORDS,
    DatasetMediumRecord: _WORDS,
    TrackMediumRecord: _WORDS,
}


def list_undeciding(record: type[BaseModel]) -> set[str]:
    """Return the keys of a table, but not of tables within it, that decide no number."""
    return {key for kind in record.__mro__ for key in UNDECIDING.get(kind, ())}


def select_deciding(value: Any, but: Collection[str] = ()) -> Any:  # noqa: ANN401 - any value of a key
    """Return the keys of a table that decide, with defaults filled in, and those of the tables within it.

    Keys in `but`, wherever they stand, are left out too: what follows from them is known by itself.
    """
    if isinstance(value, BaseModel):
        left = list_undeciding(type(value)).union(but)
        fields = ((name, getattr(value, name)) for name in type(value).model_fields)
        return {name: select_deciding(one, but) for name, one in fields if name not in left}
    if isinstance(value, Mapping):
        return {key: select_deciding(one, but) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [select_deciding(one, but) for one in value]
    return value
