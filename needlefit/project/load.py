"""TOML file -> checked record; every fault names the file and the key."""

import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from needlefit.errors import ConfigError
from needlefit.project import reading
from needlefit.project.places import label
from needlefit.project.schema_faults import schema_faults, together
from needlefit.project.toml_lines import place_of

R = TypeVar("R", bound=BaseModel)


def load(path: Path, kind: type[R]) -> R:
    """Read `path` and check it against the record `kind`.

    Raises
    ------
    ConfigError
        If the file is missing, is no TOML, or holds a wrong, missing or unknown key.
    """
    return check(read_toml(path), kind, path)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise ConfigError with file and line if it cannot be read."""
    return reading.read_toml(path, ConfigError, label(path))


def check(tables: dict[str, Any], kind: type[R], where: Path | str) -> R:
    """Check parsed tables against the record `kind`; `where` is named in the error.

    Types are strict: `"0.1"` is a text and no number. Members of a list are numbered from 1, as layers
    are: `layers.1` is the first one.

    Raises
    ------
    ConfigError
        Listing every wrong, missing or unknown key.
    """
    try:
        # as JSON, whose lists strictly are tuples
        return kind.model_validate_json(json.dumps(tables, default=_timed), strict=True)
    except ValidationError as error:
        faults = schema_faults(error, kind)
        raise ConfigError(
            "; ".join(fault.what for fault in faults),
            where=where if isinstance(where, str) else place_of(where, faults[0].key),
            expected=together([(fault.key, fault.expected) for fault in faults]),
            mend="; ".join(fault.mend for fault in faults if fault.mend),
        ) from None


def _timed(value: object) -> dict[str, str]:
    """Stand in for a date or time, TOML's only values without a JSON form, where no key wants one."""
    return {"date or time": str(value)}
