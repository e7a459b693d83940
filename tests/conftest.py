"""For all tests: one thread for linear algebra, as in every run, and what is compiled is compiled once.

BLAS threads that wait for each other on busy cores take ten times what their work takes. Modules that each
process of a command compiles, and tests that each run compiles, took a tenth of the time: `__pycache__` keeps
them, whatever the environment says.
"""

import os
import sys

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from needlefit.project.threads import limit_to_one_thread  # noqa: E402

limit_to_one_thread()  # before what loads BLAS; the processes of xdist, which begin later, inherit it

from needlefit.mechanics.precompile import KERNEL_PARTS, precompile  # noqa: E402


def pytest_sessionstart() -> None:
    precompile(*KERNEL_PARTS)
