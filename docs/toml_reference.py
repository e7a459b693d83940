"""Write the reference of all TOML files from their schemas, with examples from files that load.

python docs/toml_reference.py      writes docs/toml.md
"""

import ast
import inspect
import re
import textwrap
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from needlefit.project.load import read_toml
from needlefit.project.toml_text import dumps
from needlefit.schemas.base import FileRecord
from needlefit.schemas.cluster import SlurmRecord
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
from needlefit.schemas.dataset import DatasetRecord, SectionsRecord, TrackDatasetRecord
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.schemas.tracker import TrackerRecord
from needlefit.studies.kind import KINDS
from needlefit.studies.kinds.reconstruction.schema import ReconstructionBatchRecord
from needlefit.studies.kinds.tracks.schema import TrackStudyRecord

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "toml.md"
EXAMPLES = "docs/examples"

OPENING = """\
# TOML reference

Every key of every file that you may write. `docs/toml_reference.py` makes this page from the schemas that
check the files. The examples are from files that load: the shipped ones and those in `docs/examples/`.

- Every file begins with `schema`, the version of its layout. Unknown keys are errors.
- A key's ending is its unit: `_mm`, `_deg`, `_pa`, `_gpa`, `_hu`.
- Names of datasets, tissue models, recipes and scenes are looked up in your working folder, then in the
  shipped project. A name with a `/`, or that ends in `.toml`, is a path.
- `needlefit simulate --set layers.1.mu_pa=3e5` replaces one value of a scene.
"""


@dataclass(frozen=True)
class FileKind:
    """A kind of TOML file: its schema, and the examples from which keys are shown, the best first."""

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
    "tracker": (TrackerRecord, "Tracker", ()),
    "cluster": (SlurmRecord, "Slurm cluster", ()),
    "statements": (CredibilityStatementsRecord, "Credibility statements", ()),
    "tracks_study": (TrackStudyRecord, "Study of tip tracks", ("studies/guided_tip.toml",)),
}
"""Schema, title and shipped examples of every kind of file; `docs/examples/<key>*.toml` are further ones."""


def list_files() -> tuple[FileKind, ...]:
    """Return the kinds of file: those above, then every kind of study."""
    known = [record for record, _, _ in SHIPPED.values()]
    analyses = {
        name: (KINDS[name].record, f"Study of kind `{name}`", _shipped_studies(name))
        for name in KINDS.names()
        if KINDS[name].record not in (*known, *WRITTEN_BY_COMMANDS)
    }
    return tuple(
        FileKind(title, record, (*shipped, *_own_examples(key)))
        for key, (record, title, shipped) in {**SHIPPED, **analyses}.items()
    )


WRITTEN_BY_COMMANDS = (ReconstructionBatchRecord,)
"""Kinds of study that only a command makes."""


def _shipped_studies(kind: str) -> tuple[str, ...]:
    paths = sorted((ROOT / "studies").glob("*.toml"))
    return tuple(f"studies/{path.name}" for path in paths if read_toml(path).get("kind") == kind)


def _own_examples(key: str) -> list[str]:
    return [f"{EXAMPLES}/{path.name}" for path in sorted((ROOT / EXAMPLES).glob(f"{key}*.toml"))]


def write_page() -> str:
    """Return the page."""
    files, described = list_files(), dict[type[BaseModel], str]()
    elsewhere = dict(pair for one in reversed(files) for pair in collect_examples(one).items())
    contents = "\n".join(f"- [{one.title}](#{_anchor(one.title)})" for one in files)
    parts = [part for one in files for part in _describe_file(one, described, elsewhere)]
    return "\n".join([OPENING, contents, *parts]) + "\n"


def _anchor(title: str) -> str:
    return re.sub(r"[^\w -]", "", title).lower().replace(" ", "-")


Examples = Mapping[tuple[type[BaseModel], str], str]
"""An example of a key, by record and field."""


def _describe_file(
    file: FileKind, described: dict[type[BaseModel], str], elsewhere: Examples
) -> Iterator[str]:
    yield f"\n## {file.title}\n\n{_summary(file.record)}\n"
    first = (ROOT / file.examples[0]).read_text(encoding="utf-8")
    if len(first.splitlines()) <= MAX_EXAMPLE_LINES:
        yield f"```toml\n{first}```\n"
    examples = {**elsewhere, **collect_examples(file)}
    yield from _describe_record(file.record, "", file.title, examples, described)


MAX_EXAMPLE_LINES = 45
"""Longer files are not shown whole."""


def _describe_record(
    record: type[BaseModel],
    path: str,
    title: str,
    examples: Examples,
    described: dict[type[BaseModel], str],
) -> Iterator[str]:
    """Yield the table of keys of a record, then those of the tables within it that are new on the page."""
    described[record] = f"{title}: {path}" if path else title
    if path:
        yield f"\n### {described[record]}\n\n{_summary(record)}\n"
    yield "| key | value | meaning | example |\n|---|---|---|---|"
    inner = []
    for name, field in record.model_fields.items():
        key, record_in = field.alias or name, find_record(field.annotation)
        meaning = _escape(find_meaning(record, name))
        if record_in and described.get(record_in):
            meaning += f" Keys: [{_escape(described[record_in])}](#{_anchor(described[record_in])})."
        elif record_in:
            inner.append((record_in, _table_path(path, key, field)))
            described[record_in] = f"{title}: {inner[-1][1]}"
            meaning += f" Keys: [below](#{_anchor(described[record_in])})."
        example = examples.get((find_owner(record, name), name), "")
        value = f"up to `{record.SCHEMA}`, **required**" if name == "schema_" else _describe_value(key, field)
        yield f"| `{key}` | {_escape(value)} | {meaning} | {_code(example)} |"
    for record_in, path_in in inner:
        yield from _describe_record(record_in, path_in, title, examples, described)


def _table_path(path: str, key: str, field: FieldInfo) -> str:
    kind = get_origin(_unwrap(field.annotation))
    brackets = "[[{}]]" if kind is tuple else "[{}]"
    outer = path.strip("[]")
    name = f"{key}.NAME" if kind is dict else key
    return brackets.format(f"{outer}.{name}" if outer else name)


def _escape(text: str) -> str:
    """Return text as a cell; within backticks only bars need an escape."""
    parts = text.replace("|", r"\|").split("`")
    return "`".join(part if n % 2 else part.replace("<", r"\<") for n, part in enumerate(parts))


def _code(example: str) -> str:
    return "`" + example.replace("|", r"\|") + "`" if example else ""


def _summary(record: type[BaseModel]) -> str:
    return _escape(" ".join((inspect.getdoc(record) or "").partition("\n\n")[0].split()))


# --- meaning, type, default and bounds ------------------------------------------------------------------


def find_meaning(record: type[BaseModel], name: str) -> str:
    """Return the docstring below a field of a record, or below that of a base class; KeyError without one."""
    return _field_docstrings(find_owner(record, name))[name]


def find_owner(record: type[BaseModel], name: str) -> type[BaseModel]:
    """Return the record or base class that documents a field; KeyError if none does."""
    for one in record.__mro__:
        if name in _field_docstrings(one):
            return one  # type: ignore[return-value]
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
BOUNDS = {Ge: ("ge", "≥ {}"), Gt: ("gt", "> {}"), Le: ("le", "≤ {}"), Lt: ("lt", "< {}")}
LENGTHS = {MinLen: ("min_length", "at least {}"), MaxLen: ("max_length", "at most {}")}


def _describe_value(key: str, field: FieldInfo) -> str:
    """Return type, unit, bounds and default of a key."""
    unit = UNITS.get(key.rpartition("_")[2], "")
    kind = describe_type(field.annotation)
    limits = [
        words.format(f"{getattr(limit, name):g}")
        for limit in field.metadata
        for name, words in [({**BOUNDS, **LENGTHS}).get(type(limit), ("", ""))]
        if name
    ]
    parts = [f"{kind} ({unit})" if unit else kind, *limits, _describe_default(field)]
    return ", ".join(part for part in parts if part)


def _describe_default(field: FieldInfo) -> str:
    if field.is_required():
        return "**required**"
    value = field.get_default(call_default_factory=True)
    if value in (None, "", {}, ()) or isinstance(value, BaseModel):
        return ""
    return f"default `{_toml_value(value)}`"


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


def collect_examples(file: FileKind) -> dict[tuple[type[BaseModel], str], str]:
    """Return an example of every key that the example files hold, by record and field."""
    found = dict[tuple[type[BaseModel], str], str]()
    for path in file.examples:
        for key, text in _walk(file.record, read_toml(ROOT / path), ()):
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


if __name__ == "__main__":
    PAGE.write_text(write_page(), encoding="utf-8")
