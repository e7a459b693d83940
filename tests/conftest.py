"""For all tests: one thread for linear algebra, as in every run, and what is compiled is compiled once.

BLAS threads that wait for each other on busy cores take ten times what their work takes. Modules that each
process of a command compiles, and tests that each run compiles, took a tenth of the time: `__pycache__` keeps
them, whatever the environment says.
"""

import gc
import locale
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.pop("COLUMNS", None)  # of the screen that runs the tests
sys.dont_write_bytecode = False

from needlefit.project.processes import limit_to_one_thread  # noqa: E402

limit_to_one_thread()  # before what loads BLAS; the processes of xdist, which begin later, inherit it

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

pytest.register_assert_rewrite("made_again")

from world import open_world  # noqa: E402

TWIN = Path(__file__).parents[1] / "data" / "twin"

for folder in ("benchmarks", "studies"):  # of the renderer of scans, and of the synthetic dataset
    sys.path.append(str(Path(__file__).parents[1] / folder))

settings.register_profile("busy cores", deadline=None)  # the first example of a test also loads what it needs
settings.load_profile("busy cores")


LOCALE = locale.setlocale(locale.LC_CTYPE)


@pytest.fixture(autouse=True)
def keep_locale():
    """Begin with the locale of the process: what a test loads may have set another one."""
    locale.setlocale(locale.LC_CTYPE, LOCALE)


SWEEP_PARTS = 16
"""A session without `-m` runs one part of the tests that are marked `sweep`; `-m sweep` runs them all."""


def pytest_addoption(parser):
    about = f"the part of the sweeps to run, from 0 to {SWEEP_PARTS - 1} (default: by the commit)"
    parser.addoption("--sweep-part", type=int, help=about)


@cache
def find_sweep_part():
    """Return the part that the hash of the commit chooses; 0 where there is none."""
    try:
        words = ("git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD")
        commit = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return 0
    return int(commit, 16) % SWEEP_PARTS


def _is_asked_for(config, mark):
    return mark in config.option.markexpr or any("::" in one for one in config.args)


def _choose_sweep_part(config):
    """Return the part of the sweeps that is run; None for all of them."""
    if _is_asked_for(config, "sweep"):
        return None
    given = config.getoption("--sweep-part")
    return find_sweep_part() if given is None else given % SWEEP_PARTS


def pytest_collection_modifyitems(config, items):
    """Keep every sixteenth of the tests in sweeps, so each long one has its share, and none on demand."""
    if not _is_asked_for(config, "on_demand"):
        on_demand = [one for one in items if one.get_closest_marker("on_demand")]
        config.hook.pytest_deselected(items=on_demand)
        items[:] = [one for one in items if one not in on_demand]
    part = _choose_sweep_part(config)
    if part is not None:
        sweeps = [one for one in items if one.get_closest_marker("sweep")]
        left_out = {one for n, one in enumerate(sweeps) if n % SWEEP_PARTS != part}
        config.hook.pytest_deselected(items=[*left_out])
        items[:] = [one for one in items if one not in left_out]


def pytest_terminal_summary(terminalreporter, config):
    part = _choose_sweep_part(config)
    if part is not None:
        how = f"--sweep-part {part} repeats this one, -m sweep runs all"
        terminalreporter.write_line(f"sweeps: part {part} of {SWEEP_PARTS} ({how})")


def pytest_collection_finish():
    """Keep modules and tests, which stay to the end, out of every later search for garbage."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


def _require_registered_columns():
    """Let every table that a test writes fail that has a column which stands in no registry."""
    from needlefit.reporting import table_files
    from needlefit.reporting.table import find_column

    to_tidy = table_files.to_tidy

    def checked(frame):
        found = to_tidy(frame)
        unknown = [name for name in found if not find_column(str(name)).explanation]
        assert not unknown, f"declare in needlefit/reporting/columns.csv: {unknown}"
        return found

    table_files.to_tidy = checked


_require_registered_columns()


def _read_twin_once():
    """Read the shipped dataset once a process: a hundred runs begin with it, and no test changes it."""
    from needlefit.datasets import read as reading
    from needlefit.datasets.sources import find_dataset_file

    inspect_any, known = reading.inspect, {}

    def inspected(path, root=None):
        file = find_dataset_file(path).resolve()
        if root is not None or not file.is_relative_to(TWIN):
            return inspect_any(path, root)
        if str(path) not in known:
            known[str(path)] = inspect_any(path)
        return known[str(path)]

    reading.inspect = inspected


_read_twin_once()


@pytest.fixture(scope="session")
def world(tmp_path_factory):
    """The tiny world: a project, and one finished run of every kind of study."""
    return open_world(tmp_path_factory)


@pytest.fixture
def few_draws(monkeypatch):
    from light_runs import predict_by_few_draws

    predict_by_few_draws(monkeypatch)


@pytest.fixture
def blank_figures(monkeypatch):
    from light_runs import draw_blank

    draw_blank(monkeypatch)
