"""What docstrings and signatures need before they are read as markup; they are written as prose."""

import re

from numpy import float64, int64
from numpy.typing import ArrayLike, NDArray
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
    """Let bars be bars and sections be fields; a constant has no sections."""
    lines[:] = [line.replace("|", r"\|") for line in lines]
    if what not in ("attribute", "data", "property"):
        lines[:] = NumpyDocstring(lines, SECTIONS, app, what, name, found, options).lines()


def _shorten(
    app: Sphinx,
    what: str,
    name: str,
    found: object,
    options: object,
    signature: str | None,
    returned: str | None,
) -> tuple[str, str | None] | None:
    """Return a signature with the code's names of arrays."""
    if signature is None:
        return None
    signature = re.sub(r"<[^<>]+>", "...", signature)  # a default that has no name: a factory, an object
    for long, short in SHORT.items():
        signature = signature.replace(long, short)
        returned = returned and returned.replace(long, short)
    return signature, returned
