"""What a user waits for: `needlefit --help`, `needlefit validate all`, and the most memory either takes.

    python benchmarks/whole_program.py [--json] [--help-runs 9] [--skip-validate] [--cold]

Runs the installed program as whole processes. `--cold` first gives numba an empty cache folder, so that the
kernel is compiled again, as after a fresh install. Memory is the largest resident set of a single process
(getrusage of finished children).
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def seconds(command: list[str], folder: Path, environment: dict[str, str]) -> float:
    """Run a command to its end and return how long it took."""
    begin = time.perf_counter()
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--help-runs", type=int, default=9)
    parser.add_argument("--skip-validate", action="store_true")
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    program = [sys.executable, "-m", "needlefit"]
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ)
        if arguments.cold:
            environment["NEEDLEFIT_CACHE_DIR"] = f"{folder}/numba"
        where = Path(folder)
        times = [seconds([*program, "--help"], where, environment) for _ in range(arguments.help_runs)]
        figures["help_seconds_median"] = statistics.median(times)
        figures["python_seconds_median"] = statistics.median(
            seconds([sys.executable, "-c", "pass"], where, environment) for _ in range(arguments.help_runs)
        )
        if not arguments.skip_validate:
            figures["validate_all_seconds"] = seconds([*program, "validate", "all", "-q"], where, environment)
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # KiB on Linux
        figures["peak_memory_mib"] = peak / 1024
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for name, value in figures.items():
        print(f"{name:24s} {value:10.3f}")


if __name__ == "__main__":
    main()
