"""Base classes of all schemas: frozen records without unknown keys, names, rigid motions, planes."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError

from needlefit.schemas.limits import MAX_NUMBER
from needlefit.schemas.names import file_name_fault, name_fault

Compared = Literal["plane", "space"]  #: in their planes, or in space
#: number of a point's deflections that are compared
DIRECTIONS: dict[Compared, int] = {"plane": 1, "space": 2}


class Record(BaseModel):
    """A checked, frozen table of a TOML file; unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        populate_by_name=True,
        protected_namespaces=(),
        defer_build=True,  # a command uses few of all schemas
    )

    @field_validator("*")
    @classmethod
    def _check_numbers(cls, value: object) -> object:
        _require_bounded(value)
        return value


def _require_bounded(value: object) -> None:
    """Raise ValueError for a number, alone or in a list or table, whose products may overflow."""
    if isinstance(value, float):
        if abs(value) > MAX_NUMBER:
            raise ValueError(f"{value:.6g} is too large: numbers are at most {MAX_NUMBER:g}")
    elif isinstance(value, tuple | list | dict):
        for part in value.values() if isinstance(value, dict) else value:
            if not (isinstance(part, float) and abs(part) <= MAX_NUMBER):  # no call for each of thousands
                _require_bounded(part)


class FileRecord(Record):
    """A whole TOML file; `schema` is the version of its layout.

    `SCHEMA` is the version of today. A file of a lower one is read if its keys are those of today.
    """

    SCHEMA: ClassVar[int] = 1

    schema_: int = Field(alias="schema", ge=1)
    """Version of the layout of this file."""

    @field_validator("schema_")
    @classmethod
    def _check_schema(cls, schema: int) -> int:
        if schema > cls.SCHEMA:
            raise ValueError(
                f"{schema} is of a later version of needlefit; this one reads up to {cls.SCHEMA}"
            )
        return schema


MISSING_KEY = "missing_key"  #: type of the error of a key that the value of another key requires


def missing_key(*location: str) -> PydanticCustomError:
    """Return the error of a key, below the table that is checked, that other keys require."""
    return PydanticCustomError(MISSING_KEY, "key is missing", {"location": location})


def _check_name(name: str) -> str:
    return _require_no_fault(name, name_fault(name))


def _check_file_name(name: str) -> str:
    return _require_no_fault(name, file_name_fault(name))


def _require_no_fault(name: str, fault: str) -> str:
    if fault:
        raise ValueError(f"{name!r} is refused: {fault}")
    return name


# Functions of the module, not of a call: the documentation links the validators by name.
Name = Annotated[str, AfterValidator(_check_name)]  #: a name that reaches tables
FileName = Annotated[str, AfterValidator(_check_file_name)]  #: a name that files have, too


Row4 = tuple[float, float, float, float]
Rows = tuple[Row4, Row4, Row4]

#: largest deviation of a rotation's columns from unit length and from right angles
MAX_ROTATION_DEVIATION = 1e-6


def _require_rigid(rows: Rows) -> Rows:
    (a, b, c, _), (d, e, f, _), (g, h, i, _) = rows
    columns = ((a, d, g), (b, e, h), (c, f, i))
    products = [sum(x * y for x, y in zip(p, q, strict=True)) for p in columns for q in columns]
    square = all(abs(product - (n % 4 == 0)) <= MAX_ROTATION_DEVIATION for n, product in enumerate(products))
    turned = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if not (square and turned > 0 and all(math.isfinite(row[3]) for row in rows)):
        raise ValueError(
            "must be three rows of a rotation and a shift (mm): no scale, no reflection, "
            "e.g. [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]"
        )
    return rows


#: rotation and shift (mm) side by side, a row for each axis of the frame to which it leads
RigidRows = Annotated[Rows, AfterValidator(_require_rigid)]
