"""For all tests: one thread for linear algebra, as in every run, and what is compiled before any of them.

BLAS threads that wait for each other on busy cores take ten times what their work takes. Modules are compiled
as the kernel is: where PYTHONDONTWRITEBYTECODE is set, each process of a command would do it.
"""

import compileall
from pathlib import Path

import needlefit
from needlefit.project.threads import begin_with_one_thread

begin_with_one_thread()  # before what loads BLAS; the processes of xdist, which begin later, inherit it

from needlefit.mechanics.warm import ROOMS, warm  # noqa: E402


def pytest_sessionstart() -> None:
    compileall.compile_dir(Path(needlefit.__file__).parent, quiet=2)
    warm(*ROOMS)
