"""Find everything that can be added without a list to extend: tissue laws, file formats, metrics, ...

A `Registry` knows one type of entry. Built-in entries are the module-level instances of one package, by their
names, and those of its modules, by the name of the module, which is imported when it is used. All
module-level instances of plugins (`needlefit.plugins`) are registered.
"""

import difflib
import pkgutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from types import ModuleType
from typing import Any, Generic, Protocol, TypeVar

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.plugins import Plugin, load_plugins


class Named(Protocol):
    """What can be registered."""

    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)


class Registry(Generic[T]):
    """All entries of one type, by name; `noun` is what an entry is called in messages."""

    def __init__(self, entry_type: type[T], package: str, noun: str) -> None:
        self._type, self._package, self._noun = entry_type, package, noun
        self._builtin: dict[str, T] = {}
        self._plugins: tuple[Plugin, ...] = ()  # those that `_found` was filled from
        self._found: dict[str, tuple[T, Plugin]] = {}

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted; built-in entries are not imported for it."""
        return tuple(sorted({*self._builtin_names, *self._added()}))

    def values(self) -> tuple[T, ...]:
        """Return all entries, sorted by name."""
        return tuple(self[name] for name in self.names())

    def __contains__(self, name: object) -> bool:
        return name in self._builtin_names or name in self._added()

    def __getitem__(self, name: str) -> T:
        if name in (added := self._added()):
            return added[name][0]
        if name not in self._builtin_names:
            raise self.unknown_name_error(name)
        return self._get_builtin(name)

    def _get_builtin(self, name: str) -> T:
        if name not in self._builtin:
            module = import_module(f"{self._package}.{name}")
            if name not in (entries := self._instances(module)):
                problem = f"holds no {self._type.__name__} called `{name}`"
                raise ConfigError(
                    problem, where=str(module.__file__), expected="one with the name of the file"
                )
            self._builtin[name] = entries[name]
        return self._builtin[name]

    def plugin_of(self, name: str) -> Plugin | None:
        """Return the plugin that an entry comes from; None for a built-in entry."""
        return self._added().get(name, (None, None))[1]

    @contextmanager
    def plugin_error_context(self, name: str) -> Iterator[None]:
        """Raise ConfigError, which names the plugin, where code of an entry that a plugin adds fails."""
        try:
            yield
        except Exception as error:  # a plugin is code of others
            plugin = self.plugin_of(name)
            if plugin is None or isinstance(error, NeedlefitError):
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
        problem = f"there is no {self._noun} called `{name}`"
        fix = f"write {similar[0]}" if similar else "use one of these, or name the plugin with --plugins"
        return ConfigError(problem, expected=f"one of {', '.join(self.names())}", fix=fix, key=key)

    @cached_property
    def _builtin_names(self) -> frozenset[str]:
        package = import_module(self._package)
        self._builtin |= self._instances(package)
        modules = (module.name for module in pkgutil.iter_modules(package.__path__))
        return frozenset([*self._builtin, *(name for name in modules if not name.startswith("_"))])

    def _instances(self, module: ModuleType) -> dict[str, T]:
        return {value.name: value for value in list(vars(module).values()) if isinstance(value, self._type)}

    def _added(self) -> dict[str, tuple[T, Plugin]]:
        """Return the entries of plugins; ConfigError if a name exists already."""
        if (plugins := load_plugins()) is not self._plugins:
            self._plugins, self._found = plugins, {}
            for plugin in plugins:
                for name, entry in self._instances(plugin.module).items():
                    self._add(name, entry, plugin)
        return self._found

    def _add(self, name: str, entry: T, plugin: Plugin) -> None:
        existing, place = self._found.get(name, (entry, plugin))[0], f"{self._package}.{name}"
        if name in self._found:
            place = self._found[name][1].name
        elif name in self._builtin_names:
            existing = self._get_builtin(name)
        else:
            self._found[name] = entry, plugin
        if existing is not entry:  # a plugin may import one that is known
            self._plugins = ()
            problem = f"the {self._noun} `{name}` of the plugin {plugin.name} exists already, in {place}"
            raise ConfigError(
                problem, expected="every name once", fix="rename it, or leave one of the two out"
            )


def plugin_versions(*used: tuple[Registry[Any], str]) -> dict[str, str]:
    """Return the versions of the plugins that these entries, (registry, name), come from."""
    plugins = [registry.plugin_of(name) for registry, name in used]
    return {plugin.name: plugin.version for plugin in plugins if plugin}
