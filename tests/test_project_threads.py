"""Linear algebra is in one thread: on the command line, in its processes, in the runs of a program."""

import os
import subprocess
import sys

from threadpoolctl import threadpool_info, threadpool_limits

from needlefit.project.threads import THREAD_VARIABLES, one_thread

COMMAND = """
import sys
from needlefit.cli import main
try:
    main(["--version"])
except SystemExit:
    pass
assert "numpy" not in sys.modules
import scipy.linalg
from threadpoolctl import threadpool_info
print(*[found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"])
"""


def counts() -> set[int]:
    return {found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"}


def test_a_run_from_a_program_has_one_thread_and_restores_the_setting():
    with threadpool_limits(2, user_api="blas"):
        before = counts()
        assert one_thread(counts)() == {1}
        assert counts() == before == {2}


def test_the_command_line_has_one_thread_whatever_the_environment():
    environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, "2")}
    done = subprocess.run(
        [sys.executable, "-c", COMMAND], env=environment, capture_output=True, text=True, check=True
    )
    _, found = done.stdout.splitlines()
    assert set(found.split()) == {"1"}
