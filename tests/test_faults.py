"""A full disk, a failing one, and `kill -9` at steps by which commands write: nothing is lost or half done.

After each fault the old result or the new one stands, whole; nobody's files are touched; going on gives the
same bytes as a run where nothing went wrong. `benchmarks/faults.py` does it at every step of every command.
"""

import random

import pytest
from faults.commands import COMMANDS
from faults.injection import KINDS
from faults.outcome import prepare, spoil
from faults.server import Server


@pytest.fixture(scope="module")
def server():
    with Server() as found:
        yield found


def wrong(name, count, seed, server, folder):
    """Return what went against the promises at some faults, by the fault."""
    prepared = prepare(name, folder, server)
    faults = list(prepared.faults(KINDS))
    chosen = random.Random(seed).sample(faults, min(count, len(faults)))
    found = {fault: spoil(prepared, fault, server) for fault in chosen}
    return {(*fault, prepared.steps[fault[1] - 1]): why for fault, why in found.items() if why}


@pytest.mark.sweep
@pytest.mark.parametrize("name", COMMANDS)
def test_faults_at_many_steps_lose_nothing(name, server, tmp_path):
    assert wrong(name, 8, 2, server, tmp_path / "f") == {}
