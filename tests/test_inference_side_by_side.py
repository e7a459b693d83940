"""Searches that run side by side evaluate together, and none depends on another."""

import threading
from functools import partial

import numpy as np
import pytest
from refusals import refusal

from needlefit.errors import ModelError
from needlefit.inference.side_by_side import MAX_SEARCHES, evaluate, run_side_by_side
from needlefit.project.callbacks import never_stop
from needlefit.project.tasks import TaskStop

LIMIT_S = 20.0


class Recorded:
    """Squares of thetas, and how many were asked for at once."""

    def __init__(self):
        self.sizes = []

    def square(self, thetas, jobs):
        self.sizes.append(len(thetas))
        if np.any(thetas < 0):
            raise ModelError("below zero")
        return [float(theta[0]) ** 2 for theta in thetas]


def search(recorded, steps):
    return sum(evaluate(recorded.square, np.array([float(k)])) for k in range(steps))


def run(work, items, stop=None):
    found = {}

    def collect():
        try:
            found.update(run_side_by_side(work, items, 1, stop or TaskStop(never_stop)))
        except Exception as error:
            found["error"] = error

    thread = threading.Thread(target=collect, daemon=True)
    thread.start()
    thread.join(LIMIT_S)
    assert not thread.is_alive(), "searches wait for each other"
    if "error" in found:
        raise found["error"]
    return found


@pytest.mark.parametrize("count", [1, 2, MAX_SEARCHES, 2 * MAX_SEARCHES + 3])
def test_all_searches_of_equal_length_evaluate_together(count):
    recorded = Recorded()
    found = run(partial(search, recorded), [4] * count)
    assert found == dict.fromkeys(range(count), 14.0)
    assert sum(recorded.sizes) == 4 * count and recorded.sizes[0] == min(count, MAX_SEARCHES)


def test_searches_of_different_lengths_and_functions_all_end():
    recorded, steps = Recorded(), [1, 5, 0, 9, 2, 30]
    found = run(partial(search, recorded), steps)
    assert found == {n: search(Recorded(), count) for n, count in enumerate(steps)}
    assert recorded.sizes[:2] == [5, 4] and recorded.sizes[-1] == 1


def test_errors_bugs_and_stops_end_what_they_concern():
    recorded = Recorded()

    def fail(value):
        try:
            return f"{evaluate(recorded.square, np.array([value])):g}"
        except ModelError as error:
            return type(error).__name__

    assert run(fail, [2.0, -1.0, 3.0]) == {0: "4", 1: "ModelError", 2: "9"}
    assert recorded.sizes == [3, 1, 1, 1]

    def broken(thetas, jobs):
        raise ZeroDivisionError if len(thetas) < 3 else KeyError("bug")

    refusal(KeyError, "", lambda: run(lambda value: evaluate(broken, np.array([value])), [1.0, 2.0, 3.0]))
    stop = TaskStop(never_stop)
    stop.leave()
    assert run(partial(search, Recorded()), [3] * 40, stop) == {}
