"""Compiling ahead: what runs afterwards is the same function in every process."""

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


def test_another_process_compiles_what_is_missing(monkeypatch):
    asked = []
    monkeypatch.setattr(module, "compiled", lambda room: room != "lanes")
    monkeypatch.setattr(module.subprocess, "run", lambda words, **options: asked.append(words))
    warm(*ROOMS)
    ((python, flag, program),) = asked
    assert (python, flag) == (sys.executable, "-c")
    monkeypatch.setattr(module, "insert", asked.append)
    exec(program)
    assert asked[1:] == [["lanes"]]
