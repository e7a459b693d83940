"""What every record has in common: frozen, no unknown keys, `schema = 1`."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from needlefit.project.names import file_name_fault, name_fault


class Record(BaseModel):
    """A checked, frozen table of a TOML file; unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, protected_namespaces=()
    )


class FileRecord(Record):
    """A whole TOML file; `schema = 1` is the version of its layout."""

    schema_: Literal[1] = Field(alias="schema")


def _reaches_tables(name: str) -> str:
    fault = name_fault(name)
    if fault:
        raise ValueError(f"{name!r} is refused: {fault}")
    return name


def _names_files(name: str) -> str:
    fault = file_name_fault(name)
    if fault:
        raise ValueError(f"{name!r} is refused: {fault}")
    return name


Name = Annotated[str, AfterValidator(_reaches_tables)]
"""A name that reaches tables."""

FileName = Annotated[str, AfterValidator(_names_files)]
"""A name that files have, too."""
