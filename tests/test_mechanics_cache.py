"""Compiled functions are the same wherever they come from, and a cache that is bad is no cache."""

import inspect
import os
import stat
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from kernel_functions import kernel_functions, run_kernel
from numba.core.dispatcher import Dispatcher

from needlefit.mechanics.kernel import beam, cache
from needlefit.mechanics.kernel.grid import find_cell

ARGUMENTS, CELL = (7.25, 0.5, 1.0), 8


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(cache, "find_cache_folder", lambda: cache.CacheFolder(tmp_path))
    monkeypatch.setattr(cache, "_unsaved", [])
    return tmp_path


def called_by(function: Dispatcher) -> set[Dispatcher]:
    names, known = function.py_func.__code__.co_names, function.py_func.__globals__
    found = [known.get(name) for name in names]
    found += [getattr(room, name, None) for room in found if inspect.ismodule(room) for name in names]
    return {one for one in found if isinstance(one, Dispatcher)} - {function}


def test_sums_that_may_be_reordered_are_compiled_once_for_each_function_that_python_calls():
    """Else the copy that runs, and the last digits with it, depend on what was compiled or loaded before."""
    calls = {one: called_by(one) for one in kernel_functions()}
    assert len(calls) > 60

    def is_loose(one: Dispatcher) -> bool:
        return bool(one.targetoptions.get("fastmath")) or any(map(is_loose, calls[one]))

    inner = set().union(*calls.values())
    loose = [one for one in calls if is_loose(one)]
    assert len(loose) > 20
    apart = [one for one in loose if one in inner and not one.targetoptions.get("forceinline")]
    assert [one.py_func.__qualname__ for one in apart] == []


def test_a_function_without_a_wrapper_raises_where_python_calls_it():
    run_kernel()  # it is compiled, and compiled functions call it
    with pytest.raises(TypeError):
        beam._integrate_direction(np.zeros(2), np.zeros(2), 0, 1.0, 1.0)


def fresh() -> Dispatcher:
    """Return a function as a new process has it: with nothing compiled."""
    function = numba.njit(cache=True, nogil=True)(find_cell.py_func)
    function._cache = cache.FileCache(function._cache, "find_cell")
    return function


def hits(function: Dispatcher) -> int:
    assert function(*ARGUMENTS) == CELL
    return sum(function.stats.cache_hits.values())


def test_a_compiled_function_is_one_file_that_the_next_process_loads(place):
    assert hits(fresh()) == 0
    (file,) = place.glob("*.compiled")
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert hits(fresh()) == 1


@pytest.mark.parametrize("damage", ["empty", "cut off", "garbage", "one bit", "a folder"])
def test_a_damaged_file_is_compiled_again(place, damage):
    hits(fresh())
    (file,) = place.glob("*.compiled")
    whole = file.read_bytes()
    middle = len(whole) // 2
    changed = {
        "empty": b"",
        "cut off": whole[:middle],
        "garbage": bytes(range(256)) * 9,
        "one bit": whole[:middle] + bytes([whole[middle] ^ 4]) + whole[middle + 1 :],
    }
    file.unlink()
    file.mkdir() if damage == "a folder" else file.write_bytes(changed[damage])
    assert hits(fresh()) == 0
    if damage != "a folder":
        assert hits(fresh()) == 1


def test_a_cache_folder_is_complete_only_if_every_file_was_kept(place, monkeypatch):
    cache.mark_complete("lanes")
    assert cache.is_complete("lanes") and not cache.is_complete("kernel")
    monkeypatch.setattr(cache, "_unsaved", ["one"])
    cache.mark_complete("kernel")
    assert not cache.is_complete("kernel")


FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
from needlefit.mechanics.kernel import beam, cache
from needlefit.mechanics.kernel.grid import find_cell
print(find_cell(7.25, 0.5, 1.0), len(cache._unsaved), cache.find_cache_folder().why_temporary)
"""


def test_on_a_full_disk_functions_run_as_they_were_compiled(tmp_path):
    environment = {**os.environ, cache.CACHE_DIR_VARIABLE: str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", FULL], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(CELL), "1"]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def chosen(monkeypatch: pytest.MonkeyPatch, place: Path | str) -> cache.CacheFolder:
    monkeypatch.setenv(cache.CACHE_DIR_VARIABLE, str(place))
    return cache.find_cache_folder.__wrapped__()


def test_the_folder_belongs_to_the_user(tmp_path, monkeypatch):
    found = chosen(monkeypatch, tmp_path / "new")
    assert found == chosen(monkeypatch, tmp_path / "new")
    assert found.path.parent == tmp_path / "new" and not found.why_temporary
    assert stat.S_IMODE(found.path.stat().st_mode) == 0o700


@pytest.mark.parametrize("fault", ["unwritable", "a file", "others write", "another user", "no such home"])
def test_where_there_is_none_a_temporary_one_is_used_and_handed_to_children(tmp_path, monkeypatch, fault):
    path = chosen(monkeypatch, tmp_path).path
    place: Path | str = tmp_path
    if fault == "no such home":
        place = "~nosuchuser/cache"
    elif fault == "unwritable":
        place = "/dev/null/cache"
    elif fault == "a file":
        path.rmdir()
        path.touch()
    elif fault == "others write":
        path.chmod(0o770)
    else:
        monkeypatch.setattr(cache.os, "geteuid", lambda: path.stat().st_uid + 1)
    found = chosen(monkeypatch, place)
    assert found.why_temporary and tmp_path not in found.path.parents
    assert stat.S_IMODE(found.path.stat().st_mode) == 0o700
    assert os.environ[cache.CACHE_DIR_VARIABLE] == str(found.path.parent)


def test_a_relative_cache_home_is_ignored(monkeypatch):
    monkeypatch.delenv(cache.CACHE_DIR_VARIABLE, raising=False)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "~nosuchuser/c")
    assert cache._find_cache_root() == Path("~/.cache/needlefit").expanduser()
