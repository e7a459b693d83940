"""What every record has in common: frozen, no unknown keys, `schema = 1`."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Record(BaseModel):
    """A checked, frozen table of a TOML file; unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, protected_namespaces=()
    )


class FileRecord(Record):
    """A whole TOML file; `schema = 1` is the version of its layout."""

    schema_: Literal[1] = Field(alias="schema")
