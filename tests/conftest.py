"""For all tests: one thread for linear algebra, as in every run, and what is compiled is compiled once.

BLAS threads that wait for each other on busy cores take ten times what their work takes. Modules that each
process of a command compiles, and tests that each run compiles, took a tenth of the time: `__pycache__` keeps
them, whatever the environment says.
"""

import gc
import os
import sys
from pathlib import Path

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from needlefit.project.threads import limit_to_one_thread  # noqa: E402

limit_to_one_thread()  # before what loads BLAS; the processes of xdist, which begin later, inherit it

from hypothesis import settings  # noqa: E402

from needlefit.mechanics.precompile import KERNEL_PARTS, precompile  # noqa: E402

TWIN = Path(__file__).parents[1] / "data" / "twin"

settings.register_profile("busy cores", deadline=None)  # the first example of a test also loads what it needs
settings.load_profile("busy cores")


def pytest_sessionstart() -> None:
    precompile(*KERNEL_PARTS)


def pytest_collection_finish() -> None:
    """Keep modules and tests, which stay to the end, out of every later search for garbage."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


def _require_registered_columns() -> None:
    """Let every table that a test writes fail that has a column which stands in no registry."""
    from needlefit.reporting import table_files
    from needlefit.reporting.columns import find_column

    to_tidy = table_files.to_tidy

    def checked(frame):
        found = to_tidy(frame)
        unknown = [name for name in found if not find_column(str(name)).explanation]
        assert not unknown, f"declare in needlefit/reporting/columns.csv: {unknown}"
        return found

    table_files.to_tidy = checked


_require_registered_columns()


def _read_twin_once() -> None:
    """Read the shipped dataset once a process: a hundred runs begin with it, and no test changes it."""
    from needlefit.datasets import read as reading
    from needlefit.datasets.sources import find_dataset_file

    inspect_dataset, known = reading.inspect_dataset, {}

    def inspected(path):
        file = find_dataset_file(path).resolve()
        if not file.is_relative_to(TWIN):
            return inspect_dataset(path)
        if str(path) not in known:
            known[str(path)] = inspect_dataset(path)
        return known[str(path)]

    reading.inspect_dataset = inspected


_read_twin_once()
