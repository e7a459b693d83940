"""What can be added by one file or a plugin, and where plugins are never looked for."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from plugin_cases import VERSION, install

from needlefit import registry
from needlefit.errors import ConfigError
from needlefit.registry import PLUGINS_VARIABLE, Registry, plugin_versions, use_plugins


@dataclass(frozen=True)
class Fruit:
    """An entry."""

    name: str


FRUIT = f"from {__name__} import Fruit\n"


@pytest.fixture
def fruits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Registry[Fruit]]:
    """A registry of a package with two entries, in a process without plugins."""
    package = tmp_path / "site" / "orchard"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "_tools.py").write_text("raise RuntimeError")
    (package / "apple.py").write_text(f"{FRUIT}APPLE = AGAIN = Fruit('apple')\n")
    (package / "pear.py").write_text(f"{FRUIT}PLUM = Fruit('plum')\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    monkeypatch.setattr(registry, "_loaded", None)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    before = set(sys.modules)
    yield Registry(Fruit, "orchard", "fruit")
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_built_in_entries_are_files_imported_when_used(fruits: Registry[Fruit]) -> None:
    assert fruits.names() == ("apple", "pear")
    assert "orchard.apple" not in sys.modules
    assert fruits["apple"] == Fruit("apple") and fruits.plugin_of("apple") is None
    assert "apple" in fruits and "fig" not in fruits
    with pytest.raises(ConfigError) as unknown:
        fruits["aple"]
    assert "apple, pear" in unknown.value.expected and "apple" in unknown.value.fix
    with pytest.raises(ConfigError) as misnamed:
        fruits["pear"]
    assert misnamed.value.where.endswith("pear.py")


@pytest.mark.parametrize("entry_point", [True, False])
def test_a_plugin_adds_every_entry_it_holds(
    fruits: Registry[Fruit], tmp_path: Path, entry_point: bool
) -> None:
    source = f"{FRUIT}from orchard.apple import APPLE\nFIG = Fruit('fig')\nA = Fruit('date')\n"
    install(tmp_path / "site", module="basket", entry_point=entry_point, source=source)
    if not entry_point:
        assert "fig" not in fruits
        use_plugins(["basket"])
    assert fruits.names() == ("apple", "date", "fig", "pear")
    versions = plugin_versions((fruits, "fig"), (fruits, "apple"))
    assert list(versions) == ["basket"]
    assert versions["basket"] == VERSION if entry_point else versions["basket"].startswith("sha256:")
    assert plugin_versions((fruits, "apple")) == {}


@pytest.mark.parametrize("name", ["apple", "fig"])
def test_a_name_that_exists_is_refused(fruits: Registry[Fruit], tmp_path: Path, name: str) -> None:
    for module in ("basket", "crate"):
        install(tmp_path / "site", module=module, source=f"{FRUIT}ONE = Fruit('{name}')\n")
    with pytest.raises(ConfigError) as refused:
        fruits.names()
    assert ("orchard.apple" if name == "apple" else "basket") in refused.value.what
    assert ("basket" if name == "apple" else "crate") in refused.value.what


@pytest.mark.parametrize("content", ["1 / 0", "import a_module_that_is_missing"])
def test_a_plugin_that_cannot_be_imported_is_named(
    fruits: Registry[Fruit], tmp_path: Path, content: str
) -> None:
    install(tmp_path / "site", module="broken", source=content)
    with pytest.raises(ConfigError, match="broken"):
        fruits.names()


@pytest.mark.parametrize("place", ["work", "work/data/twin", "elsewhere/needles"])
@pytest.mark.parametrize("entry_point", [True, False])
def test_no_plugin_is_found_in_the_working_folder_or_among_data(
    fruits: Registry[Fruit],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
    entry_point: bool,
) -> None:
    marker = tmp_path / "it-ran"
    source = f"from pathlib import Path\nPath({str(marker)!r}).touch()\n"
    install(tmp_path / place, module="planted", entry_point=entry_point, source=source)
    if place != "work":
        (tmp_path / place / "dataset.toml").touch()
    monkeypatch.syspath_prepend(tmp_path / place)
    monkeypatch.syspath_prepend("")
    if entry_point:
        assert fruits.names() == ("apple", "pear")
    else:
        use_plugins(["planted"])
        with pytest.raises(ConfigError, match="planted"):
            fruits.names()
    assert not marker.exists()
    assert "" in sys.path


def test_a_process_of_its_own_uses_the_same_plugins(
    fruits: Registry[Fruit], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "site", module="basket", entry_point=False, source="")
    use_plugins(["basket"])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"), prepend=":")
    program = "from needlefit.registry import load_plugins; print(*[one.name for one in load_plugins()])"
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert child.stdout.split() == ["basket"]


def test_an_entry_of_a_plugin_that_fails_is_named(fruits: Registry[Fruit], tmp_path: Path) -> None:
    install(tmp_path / "site", module="basket", source=f"{FRUIT}FIG = Fruit('fig')\n")
    with pytest.raises(ConfigError, match="basket"), fruits.plugin_error_context("fig"):
        1 / 0  # noqa: B018
    with pytest.raises(ZeroDivisionError), fruits.plugin_error_context("apple"):
        1 / 0  # noqa: B018
