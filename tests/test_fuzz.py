"""Whatever bytes a file holds, reading it ends in a value or in one of our errors, soon and in little memory.

The readers and their valid inputs stand in `fuzzing/readers.py`; `benchmarks/fuzz.py` runs the same for as
long as it is asked to.
"""

import pytest
from fuzzing.campaign import Workers
from fuzzing.readers import READERS
from fuzzing.worker import MAX_MIB, MAX_SECONDS

SEED = 1
BATCHES = 6
"""Of mutants of each reader; the first holds its valid inputs too."""


@pytest.fixture(scope="session")
def workers():
    with Workers() as found:
        yield found


@pytest.mark.sweep
@pytest.mark.parametrize("batch", range(BATCHES))
@pytest.mark.parametrize("reader", READERS)
def test_damaged_input_is_read_or_refused(workers, reader, batch):
    """Mutants whose reading is against the rule are listed with why."""
    size = workers.inputs(reader) + READERS[reader].mutants
    verdicts = list(workers.verdicts(reader, range(batch * size, (batch + 1) * size), SEED))
    assert all(one.seconds <= MAX_SECONDS and one.mib <= MAX_MIB for one in verdicts)
    assert {one.number: one.detail for one in verdicts if one.outcome == "violation"} == {}
