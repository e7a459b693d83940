"""The API reference: a page for every package of the program, written from its modules and their
docstrings.
"""

import inspect
import pkgutil
from collections.abc import Iterator
from importlib import import_module

from pages import keep
from sphinx.application import Sphinx

import needlefit

ELSEWHERE = {"cli", "__main__"}  # the command line has a reference of its own
PACKAGES = {package.name for package in pkgutil.iter_modules(needlefit.__path__)} - ELSEWHERE
FOLDER = "reference/api"
NOT_OURS = "model_config"  # pydantic's

INDEX = """\
# API

What `import needlefit` offers, and below it every package of needlefit, from its docstrings. Units are mm, N,
MPa and rad; `Floats` and `Ints` are numpy arrays of float64 and int64, whose shapes their descriptions say.

```{{eval-rst}}
.. py:type:: Floats
   :canonical: numpy.typing.NDArray[numpy.float64]
.. py:type:: Ints
   :canonical: numpy.typing.NDArray[numpy.int64]
.. py:type:: ArrayLike
   :canonical: numpy.typing.ArrayLike
```

## The public names

{names}

```{{eval-rst}}
.. autofunction:: needlefit.open_scene
```

## The packages

```{{toctree}}
:maxdepth: 1

{packages}
```
"""


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    folder = app.srcdir / FOLDER
    pages = dict(_pages())
    pages["index.md"] = INDEX.format(names=_public(), packages="\n".join(name[:-4] for name in pages))
    for name, text in pages.items():
        keep(folder / name, text)
    for stale in set(folder.iterdir()) - {folder / name for name in pages}:
        stale.unlink()


def _pages() -> Iterator[tuple[str, str]]:
    """Yield the page of every package and of every package within, by its file."""
    for name in sorted(PACKAGES):
        yield from _packages_of(f"needlefit.{name}")


def _packages_of(name: str) -> Iterator[tuple[str, str]]:
    module = import_module(name)
    inside = sorted(pkgutil.iter_modules(getattr(module, "__path__", [])), key=lambda found: found.name)
    files = [found.name for found in inside if not found.ispkg]
    yield (
        f"{name}.rst",
        "\n".join([_title(name, "="), _members(name), *(_file(name, file) for file in files)]),
    )
    for found in inside:
        if found.ispkg:
            yield from _packages_of(f"{name}.{found.name}")


def _file(package: str, file: str) -> str:
    return f"{_title(file, '-')}\n{_members(f'{package}.{file}')}"


def _title(name: str, line: str) -> str:
    shown = name.removeprefix("needlefit.").replace("_", r"\_")
    return f"{shown}\n{line * len(shown)}\n"


def _members(name: str) -> str:
    return f".. automodule:: {name}\n   :members:\n   :ignore-module-all:\n   :exclude-members: {NOT_OURS}\n"


def _public() -> str:
    """Return the names of `needlefit` as a table, each with the first sentence of its docstring."""
    rows = [f"| {{py:obj}}`{name} <{_home(name)}>` | {_first_line(name)} |" for name in needlefit.__all__]
    return "\n".join(["| name | what it is |", "|---|---|", *rows])


def _home(name: str) -> str:
    found = getattr(needlefit, name)
    return f"{found.__module__}.{found.__qualname__}"


def _first_line(name: str) -> str:
    paragraph = (inspect.getdoc(getattr(needlefit, name)) or "").split("\n\n")[0]
    return " ".join(paragraph.split()).replace("|", r"\|")
