"""Compiling ahead: once, by one of the processes that begin at the same time."""

import fcntl
import subprocess
import sys
import time
from contextlib import AbstractContextManager

import pytest
from kernel_functions import kernel_functions, run_kernel

from needlefit.mechanics import precompile as module
from needlefit.mechanics.kernel.cache import is_complete
from needlefit.mechanics.precompile import KERNEL_PARTS, PIECES, precompile


def test_every_variant_is_compiled_and_inserting_compiles_nothing_else():
    assert all(is_complete(part) for part in KERNEL_PARTS)
    before = [sum(one.stats.cache_misses.values()) for one in kernel_functions()]
    run_kernel()
    assert [sum(one.stats.cache_misses.values()) for one in kernel_functions()] == before


def test_compiled_functions_are_not_compiled_again(monkeypatch):
    started = []
    monkeypatch.setattr(module.subprocess, "Popen", lambda *words, **options: started.append(words))
    precompile(*KERNEL_PARTS)
    assert started == []


@pytest.mark.parametrize("missing", [("lanes",), KERNEL_PARTS])
def test_other_processes_compile_what_is_missing(missing, monkeypatch):
    pieces = {piece for part in missing for piece in PIECES[part]}
    programs = []

    class Process(AbstractContextManager):
        def __init__(self, words, **options):
            assert words[:2] == [sys.executable, "-c"]
            programs.append(words[2])

        def __exit__(self, *_):
            return None

    monkeypatch.setattr(module, "is_complete", lambda one: one not in {*missing, *pieces})
    monkeypatch.setattr(module.subprocess, "Popen", Process)
    precompile(*KERNEL_PARTS)
    compiled: list[str] = []
    monkeypatch.setattr(module, "compile_piece", compiled.append)
    for program in programs:
        exec(program)
    assert set(compiled) == pieces and len(compiled) == len(pieces)


WAIT = """
import sys, time
from pathlib import Path
from needlefit.mechanics import precompile
with precompile._hold_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_the_lock_goes_with_a_process_that_is_killed(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", WAIT, str(tmp_path / "lock")], stdout=subprocess.PIPE, text=True
    )
    with holder:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        with (tmp_path / "lock").open("w") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        holder.kill()
        holder.wait()
        begin = time.monotonic()
        with module._hold_lock(tmp_path / "lock"):
            assert time.monotonic() - begin < 10


def test_an_unavailable_lock_does_not_block(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MAX_WAIT_S", 0.3)
    with module._hold_lock(tmp_path / "lock"), module._hold_lock(tmp_path / "lock"):
        pass
    with module._hold_lock(tmp_path / "missing" / "lock"):
        pass
