"""Find everything that can be added without a list to extend: tissue laws, file formats, metrics, ...

A `Registry` knows one type of entry. Built-in entries are the module-level instances of one package, and its
modules: a file or folder there defines one instance, whose name is that of the module. Plugins are modules of
installed packages, named by their entry points in the group `needlefit.plugins` or by `--plugins`; all their
module-level instances are registered. docs/developers/plugins.md shows one.

A plugin is code, which runs with the rights of the user. It is never looked for in the working folder or in
a folder of data, which may come from somebody else: `python -m needlefit` puts the working folder on
`sys.path`.
"""

import difflib
import hashlib
import importlib.util
import os
import pkgutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any, Generic, Protocol, TypeVar

from needlefit.errors import ConfigError, NeedlefitError

GROUP = "needlefit.plugins"
"""Entry points of this group name plugin modules."""

PLUGINS_VARIABLE = "NEEDLEFIT_PLUGINS"
"""Environment variable: further plugin modules, separated by commas; `--plugins` sets it. A process that this
one starts inherits it.
"""


class Named(Protocol):
    """What can be registered."""

    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)


@dataclass(frozen=True)
class Plugin:
    """A module that adds entries; `version` is a digest of its file where it states none."""

    module: ModuleType
    version: str

    @property
    def name(self) -> str:
        """The module's name."""
        return self.module.__name__


class Registry(Generic[T]):
    """All entries of one type, by name.

    Parameters
    ----------
    entry_type : type
        Of the entries; each has a `name`.
    package : str
        The package that holds the built-in entries; modules that begin with `_` are none.
    noun : str
        What an entry is called in messages, such as `tissue law`.
    """

    def __init__(self, entry_type: type[T], package: str, noun: str) -> None:
        self._type, self._package, self._noun = entry_type, package, noun
        self._builtin: dict[str, T] = {}
        self._added: dict[str, tuple[T, Plugin]] = {}
        self._plugins: tuple[Plugin, ...] = ()  # those that `_added` was filled from

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted; built-in entries are not imported for it."""
        return tuple(sorted({*self._builtin_names(), *self._from_plugins()}))

    def values(self) -> tuple[T, ...]:
        """Return all entries, sorted by name."""
        return tuple(self[name] for name in self.names())

    def __contains__(self, name: object) -> bool:
        return name in self._from_plugins() or name in self._builtin_names()

    def __getitem__(self, name: str) -> T:
        added = self._from_plugins()
        if name in added:
            return added[name][0]
        if name not in self._builtin_names():
            raise self.unknown_name_error(name)
        return self._get_builtin(name)

    def get(self, name: str) -> T | None:
        """Return an entry; None if there is none of that name, as in a stored result of a plugin."""
        return self[name] if name in self else None  # noqa: SIM401 -- this is `get`

    def plugin_of(self, name: str) -> Plugin | None:
        """Return the plugin that an entry comes from; None for a built-in entry."""
        added = self._from_plugins().get(name)
        return added[1] if added else None

    @contextmanager
    def plugin_error_context(self, name: str) -> Iterator[None]:
        """Raise ConfigError, which names the plugin, where code of an entry that a plugin adds fails."""
        try:
            yield
        except NeedlefitError:
            raise
        except Exception as error:  # a plugin is code of others
            plugin = self.plugin_of(name)
            if plugin is None:
                raise
            raise ConfigError(
                f"the {self._noun} `{name}` of the plugin {plugin.name} failed: "
                f"{type(error).__name__}: {error}",
                expected="code that works as docs/developers/plugins.md describes",
                fix="repair the plugin, or leave it out",
            ) from error

    def unknown_name_error(self, name: str, key: str = "") -> ConfigError:
        """Return the error about a name that is not registered; `key` is the one it was read from."""
        similar = difflib.get_close_matches(name, self.names(), 1)
        what = f"there is no {self._noun} called `{name}`"
        fix = f"write {similar[0]}" if similar else "use one of these, or name the plugin with --plugins"
        return ConfigError(what, expected=f"one of {', '.join(self.names())}", fix=fix, key=key)

    def _builtin_names(self) -> frozenset[str]:
        package = import_module(self._package)
        modules = (one.name for one in pkgutil.iter_modules(package.__path__))
        self._builtin |= {entry.name: entry for entry in self._instances(package)}
        names = frozenset([*self._builtin, *(name for name in modules if not name.startswith("_"))])
        self._builtin_names = lambda: names  # type: ignore[method-assign]  # the folder does not change
        return names

    def _get_builtin(self, name: str) -> T:
        if name in self._builtin:
            return self._builtin[name]
        module = import_module(f"{self._package}.{name}")
        found = [entry for entry in self._instances(module) if entry.name == name]
        if len(found) != 1:
            what = f"{len(found)} {self._type.__name__} called `{name}` in it"
            expected = f"one module-level {self._type.__name__} whose name is that of the file"
            raise ConfigError(what, where=str(module.__file__), expected=expected)
        self._builtin[name] = found[0]
        return found[0]

    def _instances(self, module: ModuleType) -> Iterator[T]:
        """Yield each instance that a module holds, once."""
        seen: set[int] = set()
        for value in list(vars(module).values()):
            if isinstance(value, self._type) and id(value) not in seen:
                seen.add(id(value))
                yield value

    def _from_plugins(self) -> dict[str, tuple[T, Plugin]]:
        plugins = load_plugins()
        if plugins is not self._plugins:
            added: dict[str, tuple[T, Plugin]] = {}
            for plugin in plugins:
                for entry in self._instances(plugin.module):
                    if self._is_new(entry, plugin, added):
                        added[entry.name] = entry, plugin
            self._added, self._plugins = added, plugins
        return self._added

    def _is_new(self, entry: T, plugin: Plugin, added: dict[str, tuple[T, Plugin]]) -> bool:
        """Raise ConfigError if another entry has this name; a plugin may import one that is known."""
        if entry.name in added:
            other, place = added[entry.name][0], added[entry.name][1].name
        elif entry.name in self._builtin_names():
            place = f"{self._package}.{entry.name}"
            other = self._get_builtin(entry.name)
        else:
            return True
        if other is not entry:
            what = f"the {self._noun} `{entry.name}` of the plugin {plugin.name} exists already, in {place}"
            expected = "every name once"
            raise ConfigError(what, expected=expected, fix="rename it, or leave one of the two plugins out")
        return False


_lock = RLock()
_loaded: tuple[Plugin, ...] | None = None
_loading = False


def use_plugins(modules: Iterable[str]) -> None:
    """Let this process, and those that it starts, use plugin modules besides those used so far."""
    global _loaded
    with _lock:
        os.environ[PLUGINS_VARIABLE] = ",".join(dict.fromkeys((*_stated_modules(), *modules)))
        _loaded = None


def load_plugins() -> tuple[Plugin, ...]:
    """Return the plugins of this process; the first call imports them.

    ConfigError if one cannot be imported, or stands in the working folder or in a folder of data.
    """
    global _loaded, _loading
    if _loaded is not None:
        return _loaded
    with _lock:
        if _loaded is None and not _loading:  # a plugin that looks up names while it is imported sees none
            _loading = True
            try:
                with _trusted_search_path() as trusted:
                    versions = {**dict.fromkeys(_stated_modules(), ""), **_find_entry_points(trusted)}
                    _loaded = tuple(_load(name, version) for name, version in sorted(versions.items()))
            finally:
                _loading = False
        return _loaded or ()


def plugin_versions(*used: tuple[Registry[Any], str]) -> dict[str, str]:
    """Return the versions of the plugins that these entries, (registry, name), come from."""
    plugins = [registry.plugin_of(name) for registry, name in used]
    return {plugin.name: plugin.version for plugin in plugins if plugin}


def _stated_modules() -> list[str]:
    words = os.environ.get(PLUGINS_VARIABLE, "").split(",")
    return [word.strip() for word in words if word.strip()]


@contextmanager
def _trusted_search_path() -> Iterator[list[str]]:
    """Leave the working folder and folders of data out of `sys.path` for a time."""
    before = sys.path[:]
    sys.path[:] = [entry for entry in before if entry and not _is_untrusted(Path(entry).resolve())]
    trusted = sys.path[:]
    try:
        yield trusted
    finally:
        sys.path[:] = before + [entry for entry in sys.path if entry not in before]


def _is_untrusted(folder: Path) -> bool:
    here = Path.cwd()
    return (
        folder == here
        or folder.is_relative_to(here / "data")
        or any((one / "dataset.toml").is_file() for one in (folder, *folder.parents))
    )


def _find_entry_points(search_path: list[str]) -> dict[str, str]:
    return {
        entry.module: package.version
        for package in reversed(list(metadata.distributions(path=search_path)))  # the first one found wins
        for entry in package.entry_points
        if entry.group == GROUP
    }


def _load(name: str, version: str) -> Plugin:
    try:
        spec = importlib.util.find_spec(name.partition(".")[0])
        if spec is None or any(_is_untrusted(place) for place in _folders(spec)):
            expected = "an installed module; none in the working folder or in a folder of data is used"
            fix = "install it with pip, or put a folder other than the working folder on PYTHONPATH"
            raise ConfigError(f"there is no installed plugin module `{name}`", expected=expected, fix=fix)
        module = import_module(name)
    except ConfigError:
        raise
    except Exception as error:  # a plugin is code of others
        what = f"the plugin module `{name}` cannot be imported: {type(error).__name__}: {error}"
        expected = "a module that can be imported by its name"
        raise ConfigError(what, expected=expected, fix="repair, update or uninstall it") from error
    return Plugin(module, version or _stated_version(module))


def _folders(spec: importlib.machinery.ModuleSpec) -> list[Path]:
    places = spec.submodule_search_locations or [spec.origin or ""]
    return [Path(place).resolve().parent for place in places]


def _stated_version(module: ModuleType) -> str:
    top = module.__name__.partition(".")[0]
    stated = getattr(module, "__version__", getattr(sys.modules[top], "__version__", None))
    if stated:
        return str(stated)
    content = Path(module.__file__).read_bytes() if module.__file__ else b""
    return f"sha256:{hashlib.sha256(content).hexdigest()}"
