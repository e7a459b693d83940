"""Whatever bytes a file holds, reading it ends in a value or in one of our errors, soon and in little memory.

The readers and their valid inputs stand in `fuzzing/readers.py`; `benchmarks/fuzz.py` runs the same for as
long as it is asked to.
"""

import pytest
from fuzzing.campaign import Workers
from fuzzing.readers import READERS
from fuzzing.worker import MAX_MIB, MAX_SECONDS, write_case

SEED = 1
BATCHES = 6
"""Of mutants of each reader; the first holds its valid inputs too."""


@pytest.fixture(scope="session")
def workers():
    with Workers() as found:
        yield found


def wrong(workers, reader, numbers):
    """Return the mutants whose reading is against the rule, with why."""
    verdicts = list(workers.verdicts(reader, numbers, SEED))
    assert all(one.seconds <= MAX_SECONDS and one.mib <= MAX_MIB for one in verdicts)
    return {one.number: one.detail for one in verdicts if one.outcome == "violation"}


@pytest.mark.sweep
@pytest.mark.parametrize("batch", range(BATCHES))
@pytest.mark.parametrize("reader", READERS)
def test_damaged_input_is_read_or_refused(workers, reader, batch):
    size = workers.inputs(reader) + READERS[reader].mutants
    assert wrong(workers, reader, range(batch * size, (batch + 1) * size)) == {}


def test_the_same_number_is_the_same_mutant(tmp_path):
    folders = [tmp_path / name / "case" for name in ("one", "two", "other")]
    for folder, number in zip(folders, (50, 50, 51), strict=True):
        write_case("scene", number, SEED, folder)
    one, two, other = ((folder / "scene.toml").read_bytes() for folder in folders)
    assert one == two != other
