"""Compiling ahead: what runs afterwards is the same function in every process."""

import os
import subprocess
import sys

from needlefit.mechanics import warm as module
from needlefit.mechanics.kernel import compiled
from needlefit.mechanics.warm import ROOMS, insert, warm


def test_every_room_is_compiled_by_now_and_inserting_compiles_nothing_else():
    assert all(compiled(room) for room in ROOMS)
    insert(list(ROOMS))


def test_what_is_compiled_is_not_compiled_again(monkeypatch):
    started = []
    monkeypatch.setattr(module.subprocess, "run", lambda *words, **options: started.append(words))
    warm(*ROOMS)
    assert started == []


def test_another_process_compiles_what_is_missing(tmp_path):
    program = (
        "from needlefit.mechanics import kernel, warm; assert not kernel.compiled('kernel');"
        "warm.warm('kernel'); assert kernel.compiled('kernel');"
        "from needlefit.mechanics.kernel import insertion; assert not insertion.advance.signatures"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
