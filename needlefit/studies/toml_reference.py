"""The keys of every TOML file that a user may write, read out of the schemas that check the files.

The examples are from files that load: the shipped ones and those in `docs/examples/`.
"""

import ast
import inspect
import textwrap
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal, Union, cast, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from needlefit.grouping import group_values
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import dumps, read_toml
from needlefit.schemas.base import FileRecord
from needlefit.schemas.dataset import DatasetRecord, SectionsRecord, TrackDatasetRecord
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.schemas.tracks import TrackStudyRecord
from needlefit.studies.kind import KINDS

EXAMPLES = "docs/examples"


@dataclass(frozen=True)
class FileKind:
    """A kind of TOML file: its schema, and the examples from which keys are shown, the best first."""

    name: str
    title: str
    record: type[FileRecord]
    examples: tuple[str, ...]


SHIPPED: Mapping[str, tuple[type[FileRecord], str, tuple[str, ...]]] = {
    "study": (StudyRecord, "Study", ("studies/study3.toml", "studies/stereo_insertions.toml")),
    "fit": (FitRecord, "Fit", ("configs/fits/phantom1.toml",)),
    "medium": (MediumRecord, "Tissue model", ("configs/media/phantom2.toml",)),
    "prior": (MaterialRecord, "Prior of a material", ()),
    "recipe": (RecipeRecord, "Recipe", ()),
    "dataset": (DatasetRecord, "Dataset of needle shapes", ("data/twin/dataset.toml",)),
    "sections": (SectionsRecord, "Cross-sections of a needle", ()),
    "tracks_dataset": (TrackDatasetRecord, "Dataset of tip tracks", ("data/guided_tips/dataset.toml",)),
    "scene": (SceneRecord, "Scene", ("configs/scenes/phantom1.toml", "configs/scenes/figure1.toml")),
    "reconstruction": (ReconstructionRecord, "Reconstruction", ()),
    "tracks_study": (TrackStudyRecord, "Study of tip tracks", ("studies/guided_tip.toml",)),
}
"""Schema, title and shipped examples of every kind of file; `docs/examples/<key>*.toml` are further ones."""


WRITTEN_BY_COMMANDS = ("reconstruction",)  #: kinds of study that only a command makes


def list_files() -> tuple[FileKind, ...]:
    """Return the kinds of file: those above, then every kind of study."""
    folder, known = shipped_folder(), [record for record, _, _ in SHIPPED.values()]
    files = sorted((folder / "studies").glob("*.toml"))
    studies = group_values((read_toml(path).get("kind"), f"studies/{path.name}") for path in files)
    analyses = {
        name: (KINDS[name].record, f"Study of kind `{name}`", tuple(studies.get(name, ())))
        for name in KINDS.names()
        if KINDS[name].record not in known and name not in WRITTEN_BY_COMMANDS
    }
    found = []
    for key, (record, title, shipped) in {**SHIPPED, **analyses}.items():
        own = (f"{EXAMPLES}/{path.name}" for path in sorted((folder / EXAMPLES).glob(f"{key}*.toml")))
        found.append(FileKind(f"{key}.toml", title, record, (*shipped, *own)))
    return tuple(found)


@dataclass(frozen=True)
class KeyDescription:
    """A key of a table: what it takes, what it means, an example.

    `described_in` is the title of the table that describes its own keys; empty if it is no table.
    """

    key: str
    value: str
    meaning: str
    example: str
    described_in: str = ""


@dataclass(frozen=True)
class TableDescription:
    """A table of a file, or the file itself: its title, what it is, and its keys."""

    title: str
    summary: str
    keys: tuple[KeyDescription, ...]


def describe_files(files: Sequence[FileKind]) -> list[tuple[FileKind, list[TableDescription]]]:
    """Return the tables of several files; what an earlier one describes is not described again."""
    described = dict[type[BaseModel], str]()
    elsewhere = dict(pair for one in reversed(list_files()) for pair in collect_examples(one).items())
    found = []
    for file in files:
        described[file.record] = file.title
        examples = {**elsewhere, **collect_examples(file)}
        found.append((file, list(_describe_record(file.record, "", file.title, examples, described))))
    return found


Examples = Mapping[tuple[type[BaseModel], str], str]  #: an example of a key, by record and field


def _describe_record(
    record: type[BaseModel],
    path: str,
    title: str,
    examples: Examples,
    described: dict[type[BaseModel], str],
) -> Iterator[TableDescription]:
    """Yield the keys of a record, then those of the tables within it that were not described."""
    keys, inner = [], []
    for name, field in record.model_fields.items():
        key, record_in = field.alias or name, find_record(field.annotation)
        if record_in and record_in not in described:
            inner.append((record_in, _table_path(path, key, field)))
            described[record_in] = f"{title}: {inner[-1][1]}"
        example = examples.get((find_owner(record, name), name), "")
        value = _describe_value(key, field)
        if name == "schema_":  # the versions of a file's layout that are read
            value = f"up to `{cast(type[FileRecord], record).SCHEMA}`, **required**"
        place = described[record_in] if record_in else ""
        keys.append(KeyDescription(key, value, find_meaning(record, name), example, place))
    summary = " ".join((inspect.getdoc(record) or "").partition("\n\n")[0].split())
    yield TableDescription(described[record], summary, tuple(keys))
    for record_in, path_in in inner:
        yield from _describe_record(record_in, path_in, title, examples, described)


def _table_path(path: str, key: str, field: FieldInfo) -> str:
    kind = get_origin(_unwrap(field.annotation))
    brackets = "[[{}]]" if kind is tuple else "[{}]"
    outer = path.strip("[]")
    name = f"{key}.NAME" if kind is dict else key
    return brackets.format(f"{outer}.{name}" if outer else name)


# --- meaning, type, default and bounds ------------------------------------------------------------------


def find_meaning(record: type[BaseModel], name: str) -> str:
    """Return the docstring below a field of a record, or below that of a base class; KeyError without one."""
    return _field_docstrings(find_owner(record, name))[name]


def find_owner(record: type[BaseModel], name: str) -> type[BaseModel]:
    """Return the record or base class that documents a field; KeyError if none does."""
    for one in record.__mro__:
        if name in _field_docstrings(one):
            return one
    raise KeyError(f"{record.__name__}.{name} has no docstring")


@cache
def _field_docstrings(record: type) -> dict[str, str]:
    if not issubclass(record, BaseModel) or record is BaseModel:
        return {}
    body = ast.parse(textwrap.dedent(inspect.getsource(record))).body[0].body  # type: ignore[attr-defined]
    found = {}
    for field, text in pairwise(body):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            found[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return found  # fmt: skip


UNITS = {
    "mm": "mm", "deg": "°", "pa": "Pa", "gpa": "GPa", "nmm2": "N mm²", "hu": "HU", "percent": "%",
}  # fmt: skip
WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false", type(None): ""}
LIMITS: Mapping[type, tuple[str, str]] = {
    **{Ge: ("ge", "≥ {}"), Gt: ("gt", "> {}"), Le: ("le", "≤ {}"), Lt: ("lt", "< {}")},
    **{MinLen: ("min_length", "at least {}"), MaxLen: ("max_length", "at most {}")},
}


def _describe_value(key: str, field: FieldInfo) -> str:
    """Return type, unit, bounds and default of a key."""
    unit = UNITS.get(key.rpartition("_")[2], "")
    kind = describe_type(field.annotation)
    limits = [
        words.format(f"{getattr(limit, name):g}")
        for limit in field.metadata
        for name, words in [LIMITS.get(type(limit), ("", ""))]
        if name
    ]
    parts = [f"{kind} ({unit})" if unit else kind, *limits]
    if field.is_required():
        parts.append("**required**")
    else:
        value = field.get_default(call_default_factory=True)
        if not (value in (None, "", {}, ()) or isinstance(value, BaseModel)):
            parts.append(f"default `{_toml_value(value)}`")
    return ", ".join(parts)


def _unwrap(annotation: Any) -> Any:  # noqa: ANN401 - whatever may stand in an annotation
    """Return an annotation without `None` and without what `Annotated` adds."""
    if get_origin(annotation) in (Union, types.UnionType):
        given = [one for one in get_args(annotation) if one is not type(None)]
        return _unwrap(given[0]) if len(given) == 1 else annotation
    return _unwrap(get_args(annotation)[0]) if hasattr(annotation, "__metadata__") else annotation


def describe_type(annotation: Any) -> str:  # noqa: ANN401 - whatever may stand in an annotation
    """Return what a key takes, in words."""
    kind = _unwrap(annotation)
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " or ".join(f"`{_toml_value(one)}`" for one in inner)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(describe_type(one) for one in inner if one is not type(None)))
    if origin is dict:
        return f"table of {_plural(describe_type(inner[1]))} by name"
    if origin is tuple and inner[-1] is Ellipsis:
        return f"list of {_plural(describe_type(inner[0]))}"
    if origin is tuple:
        return f"list of {len(inner)} {_plural(describe_type(inner[0]))}"
    if inspect.isclass(kind) and issubclass(kind, BaseModel):
        return "table"
    return WORDS.get(kind, "value")


def _plural(words: str) -> str:
    head, space, rest = words.partition(" of ")
    return f"{head}s{space}{rest}" if head in ("number", "whole number", "table", "list") else words


# --- examples -------------------------------------------------------------------------------------------


def find_record(annotation: Any) -> type[BaseModel] | None:  # noqa: ANN401 - whatever may stand in an annotation
    """Return the record within an annotation, also in a list or a table."""
    kind = _unwrap(annotation)
    if inspect.isclass(kind) and issubclass(kind, BaseModel):
        return kind
    return next((found for one in get_args(kind) if (found := find_record(one))), None)


@cache
def collect_examples(file: FileKind) -> dict[tuple[type[BaseModel], str], str]:
    """Return an example of every key that the example files hold, by record and field."""
    found = dict[tuple[type[BaseModel], str], str]()
    for path in file.examples:
        for key, text in _walk(file.record, read_toml(shipped_folder() / path), ()):
            found.setdefault(key, text)
    return found


def _walk(
    record: type[BaseModel], table: Mapping[str, Any], path: Sequence[str]
) -> Iterator[tuple[tuple[type[BaseModel], str], str]]:
    """Yield an example of every key of a table, and of the tables within it."""
    for name, field in record.model_fields.items():
        key = field.alias or name
        if key not in table:
            continue
        value, inner = table[key], find_record(field.annotation)
        yield (find_owner(record, name), name), _show(key, value, (*path, key), is_table=inner is not None)
        if inner:
            for step, one in _tables(value):
                yield from _walk(inner, one, (*path, key, *step))


def _tables(value: Any) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:  # noqa: ANN401 - a TOML value
    """Yield the tables of a value: itself, those of a list, or those of a table by name."""
    if isinstance(value, list):
        yield from (((), one) for one in value)
    elif isinstance(value, Mapping) and value and all(isinstance(one, Mapping) for one in value.values()):
        yield from (((name,), one) for name, one in value.items())
        yield (), value
    elif isinstance(value, Mapping):
        yield (), value


MAX_EXAMPLE_CHARS = 60


def _show(key: str, value: Any, path: Sequence[str], *, is_table: bool) -> str:  # noqa: ANN401 - a TOML value
    if is_table and isinstance(value, list) and not isinstance(value[0], list | float):
        return f"[[{'.'.join(path)}]]"
    if is_table and isinstance(value, Mapping):
        return f"[{'.'.join(path)}]"
    if isinstance(value, Mapping):
        first = next(iter(value.items()), None)
        return f"{key} = {{ {dumps(dict([first])).strip()} }}" if first else f"{key} = {{}}"
    text = _toml_value(value)
    if len(text) > MAX_EXAMPLE_CHARS:
        text = text[: MAX_EXAMPLE_CHARS - 5].rpartition(" ")[0] + (
            ' ..."' if isinstance(value, str) else " ...]"
        )
    return f"{key} = {text}"  # fmt: skip


def _toml_value(value: Any) -> str:  # noqa: ANN401 - a TOML value
    return dumps({"key": value}).partition("= ")[2].strip() if value != "" else '""'
