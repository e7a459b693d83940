"""The kernel is compiled before any test, in a process of its own: all of them run the same functions."""

from needlefit.mechanics.warm import ROOMS, warm


def pytest_sessionstart() -> None:
    warm(*ROOMS)
