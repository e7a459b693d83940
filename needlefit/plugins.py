"""Find and import plugins: modules of installed packages that add tissue laws, file formats, metrics, ...

They are named by their entry points in the group `needlefit.plugins` or by `--plugins`;
docs/developers/plugins.md shows one.

A plugin is code, which runs with the rights of the user. It is never looked for in the working folder or in
a folder of data, which may come from somebody else.
"""

import hashlib
import importlib.util
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType

from needlefit.errors import ConfigError

GROUP = "needlefit.plugins"  # group of entry points that name plugin modules
PLUGINS_VARIABLE = "NEEDLEFIT_PLUGINS"
"""Environment variable: further plugin modules, separated by commas; child processes inherit it."""


@dataclass(frozen=True)
class Plugin:
    """A module that adds entries, by name; `version` is a digest of its file where it states none."""

    module: ModuleType
    name: str
    version: str


_loaded: tuple[Plugin, ...] | None = None


def use_plugins(modules: Iterable[str]) -> None:
    """Let this process, and those that it starts, use plugin modules besides those used so far."""
    global _loaded
    os.environ[PLUGINS_VARIABLE] = ",".join(dict.fromkeys((*_stated_modules(), *modules)))
    _loaded = None


def load_plugins() -> tuple[Plugin, ...]:
    """Return the plugins of this process; the first call imports them.

    ConfigError if one cannot be imported, or stands in the working folder or in a folder of data.
    """
    global _loaded
    if _loaded is None:
        _loaded = ()  # a plugin that looks up names while it is imported sees none
        before = sys.path[:]
        sys.path[:] = trusted = [
            folder for folder in before if folder and not _is_untrusted(Path(folder).resolve())
        ]
        try:
            stated = {**dict.fromkeys(_stated_modules(), ""), **_find_entry_points(list(trusted))}
            _loaded = tuple(_load(name, version) for name, version in sorted(stated.items()))
        except BaseException:
            _loaded = None
            raise
        finally:
            sys.path[:] = before + [folder for folder in sys.path if folder not in before]
    return _loaded


def _stated_modules() -> list[str]:
    return [word.strip() for word in os.environ.get(PLUGINS_VARIABLE, "").split(",") if word.strip()]


def _is_untrusted(folder: Path) -> bool:
    here = Path.cwd()
    holds_data = any((parent / "dataset.toml").is_file() for parent in (folder, *folder.parents))
    return folder == here or folder.is_relative_to(here / "data") or holds_data


def _find_entry_points(search_path: list[str]) -> dict[str, str]:
    packages = reversed(list(metadata.distributions(path=search_path)))  # the first one found wins
    # parsing the entry points of all packages takes a fiftieth of `simulate`
    adding = (package for package in packages if GROUP in (package.read_text("entry_points.txt") or ""))
    entries = [(entry, package) for package in adding for entry in package.entry_points]
    return {entry.module: package.version for entry, package in entries if entry.group == GROUP}


def _load(name: str, version: str) -> Plugin:
    try:
        spec = importlib.util.find_spec(name.partition(".")[0])
        places = [] if spec is None else spec.submodule_search_locations or [spec.origin or ""]
        if not places or any(_is_untrusted(Path(place).resolve().parent) for place in places):
            expected = "an installed module"
            fix = "install it with pip, or put a folder other than the working folder on PYTHONPATH"
            raise ConfigError(f"there is no installed plugin module `{name}`", expected=expected, fix=fix)
        module = import_module(name)
    except ConfigError:
        raise
    except Exception as error:  # a plugin is code of others
        problem = f"the plugin module `{name}` cannot be imported: {type(error).__name__}: {error}"
        raise ConfigError(
            problem, expected="a module that can be imported", fix="repair or remove it"
        ) from error
    if not version:
        content = Path(module.__file__).read_bytes() if module.__file__ else b""
        version = str(getattr(module, "__version__", f"sha256:{hashlib.sha256(content).hexdigest()}"))
    return Plugin(module, name, version)
