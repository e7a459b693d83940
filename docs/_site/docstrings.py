"""What docstrings and signatures need before they are read as markup; they are written as prose."""

import re
from collections.abc import Iterator

from numpy import float64, int64
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring
from sphinx.util.typing import stringify_annotation

SHORT = {
    stringify_annotation(long, mode): short
    for mode in ("fully-qualified-except-typing", "smart")
    for long, short in ((NDArray[float64], "Floats"), (NDArray[int64], "Ints"), (ArrayLike, "ArrayLike"))
}

# Types in docstrings are prose, "(K,) array", and stay text; exceptions are references and must exist.
SECTIONS = Config(
    napoleon_use_param=False,
    napoleon_use_rtype=False,
    napoleon_custom_sections=[("Attributes", "params_style")],
)


def setup(app: Sphinx) -> dict[str, bool]:
    """Read docstrings by the rules of this house."""
    app.connect("autodoc-process-docstring", _read)
    app.connect("autodoc-process-signature", _shorten)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _read(app: Sphinx, what: str, name: str, found: object, options: object, lines: list[str]) -> None:
    """Let bars be bars and sections be fields, and a record show its keys; a constant has no sections."""
    lines[:] = [line.replace("|", r"\|") for line in lines]
    if what not in ("attribute", "data", "property"):
        lines[:] = NumpyDocstring(lines, SECTIONS, app, what, name, found, options).lines()
    if what == "class" and isinstance(found, type) and issubclass(found, BaseModel):
        lines += ["", *_keys(found)]


def _keys(record: type[BaseModel]) -> Iterator[str]:
    """Yield the keys of a table of TOML: what each holds, and what it is by default."""
    for name, field in record.model_fields.items():
        default = "required" if field.is_required() else f"default ``{_shown(field)}``"
        yield f"* ``{field.alias or name}``: {_kind(field)}, {default}"


def _kind(field: FieldInfo) -> str:
    kind = stringify_annotation(field.annotation, "smart", short_literals=True)
    bare = re.sub(r"~?(\w+\.)+(?=\w)", "", kind)
    limits = ", ".join(f"``{limit!r}``" for limit in field.metadata)
    return f"``{bare}``" + (f" with {limits}" if limits else "")


def _shown(field: FieldInfo) -> str:
    value = field.get_default(call_default_factory=True)
    return f"{type(value).__name__}()" if isinstance(value, BaseModel) else repr(value)


def _shorten(
    app: Sphinx,
    what: str,
    name: str,
    found: object,
    options: object,
    signature: str | None,
    returned: str | None,
) -> tuple[str, str | None] | None:
    """Return a signature with the code's names of arrays; none of a record, whose keys are listed."""
    if what == "class" and isinstance(found, type) and issubclass(found, BaseModel):
        return "", None
    if signature is None:
        return None
    signature = re.sub(r"<[^<>]+>", "...", signature)  # a default that has no name: a factory, an object
    for long, short in SHORT.items():
        signature = signature.replace(long, short)
        returned = returned and returned.replace(long, short)
    return signature, returned
