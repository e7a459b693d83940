"""TOML file -> checked record; every fault names the file and the key."""

import difflib
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from needlefit.errors import ConfigError

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
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ConfigError(
            "there is no such file", where=str(path), mend="check the name and the path"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", where=str(path), expected="a UTF-8 text file") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"is not valid TOML: {error}", where=str(path), mend="mend the line named"
        ) from None


def check(tables: dict[str, Any], kind: type[R], where: Path | str) -> R:
    """Check parsed tables against the record `kind`; `where` is named in the error.

    Members of a list are numbered from 1, as layers are: `layers.1` is the first one.

    Raises
    ------
    ConfigError
        Listing every wrong, missing or unknown key.
    """
    try:
        return kind.model_validate(tables)
    except ValidationError as error:
        faults = [_describe(e["loc"], e["msg"], e.get("input"), kind) for e in error.errors()]
        raise ConfigError(
            "; ".join(faults), where=str(where), mend=f"mend the key{'s' if len(faults) > 1 else ''} named"
        ) from None


def _describe(location: tuple[int | str, ...], message: str, value: object, kind: type[BaseModel]) -> str:
    key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in location)
    message = message.removeprefix("Value error, ")
    if message.startswith("Extra inputs"):
        near = difflib.get_close_matches(str(location[-1]), _keys(kind, location[:-1]), n=1, cutoff=0.5)
        return f"key `{key}` is unknown" + (f"; did you mean `{near[0]}`?" if near else "")
    if message == "Field required":
        return f"key `{key}` is missing"
    got = f" (got {value!r})" if isinstance(value, str | int | float | bool) else ""
    return f"key `{key}`: {message}{got}" if key else f"{message}{got}"


def _keys(kind: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys of the table at `location` of a record; none where that is no single record."""
    for part in location:
        if isinstance(part, int):
            continue  # a list: its members' record was found with its key
        fields = {field.alias or name: field for name, field in kind.model_fields.items()}
        if part not in fields:
            continue  # the name of a table in a mapping, found with the mapping's key
        inner = list(_records(fields[part].annotation))
        if len(inner) != 1:
            return []
        kind = inner[0]
    return [field.alias or name for name, field in kind.model_fields.items()]


def _records(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the records that a type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _records(inner)
