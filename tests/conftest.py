"""Linear algebra in one thread, as in every run; the kernel compiled before any test, in another process.

BLAS threads that wait for each other on busy cores would take ten times what their work takes.
"""

from needlefit.project.threads import begin_with_one_thread

begin_with_one_thread()  # before what loads BLAS; the processes of xdist, which begin later, inherit it

from needlefit.mechanics.warm import ROOMS, warm  # noqa: E402


def pytest_sessionstart() -> None:
    warm(*ROOMS)
