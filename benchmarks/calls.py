"""Count what `validate study3` calls, in the recipe `quick`: a guard of its cost that needs no clock.

    python benchmarks/calls.py
    python benchmarks/calls.py --write "why the counts have changed"

With `--jobs 1`: calls of the kernel, the steps and parameter sets that these compute, and calls of
functions of needlefit. Fails where one is above 1.05 of its number in `calls.toml`; `--write` stores the
counts there, with the reason. On the oldest Python: later ones inline comprehensions, and may have other
libraries.
"""

import argparse
import json
import sys
import tempfile
import threading
import tomllib
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType

import needlefit
from needlefit.cli import main as run_command
from needlefit.mechanics import native

MAX_RATIO = 1.05
STUDY = Path(__file__).resolve().parents[1] / "studies" / "study3.toml"
FILE = Path(__file__).with_suffix(".toml")
PACKAGE = str(Path(needlefit.__file__).parent)


class Kernel:
    """The kernel, which counts its calls."""

    def __init__(self) -> None:
        self.run, self.calls, self.steps = native.simulate, 0, 0

    def __call__(
        self, problem: native.KernelProblem, shapes: native.Shapes, first: int, lanes: int, *memory
    ) -> None:
        self.calls += 1
        self.steps += problem.stop_count * min(lanes, problem.sets - first)
        self.run(problem, shapes, first, lanes, *memory)


def count_calls() -> dict[str, int]:
    """Run the study; return the counts by name."""
    found: Counter[CodeType] = Counter()
    kernel = native.simulate = Kernel()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            found[frame.f_code] += 1

    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder, "study3.toml")
        study.write_text(STUDY.read_text().replace('recipe = "default"', 'recipe = "quick"'))
        sys.argv = ["needlefit", "validate", str(study), "--jobs", "1", "--quiet", "--json", "--out", folder]
        threading.setprofile(note)
        sys.setprofile(note)
        try:
            run_command()
        except SystemExit as end:
            if end.code:
                raise
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
    own = (
        count
        for code, count in found.items()
        if code.co_filename.startswith(PACKAGE) and code.co_name[0] != "<"
    )
    return {"kernel_calls": kernel.calls, "steps_and_sets": kernel.steps, "function_calls": sum(own)}


def main() -> None:
    """Compare the counts with the stored ones, or store them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", metavar="REASON", help="store the counts, and why they have changed")
    reason = parser.parse_args().write
    counts = count_calls()
    if reason:
        lines = [f"{name} = {count}" for name, count in counts.items()]
        FILE.write_text("\n".join([f"reason = {json.dumps(reason)}", *lines]) + "\n")
    stored, above = tomllib.loads(FILE.read_text()), list[str]()
    for name, count in counts.items():
        ratio = count / stored[name]
        print(f"{name}: {count}, stored {stored[name]}, ratio {ratio:.3f}", file=sys.stderr)
        above += [name] * (ratio > MAX_RATIO)
    if above:
        sys.exit(
            f"above {MAX_RATIO} of {FILE.name}: {', '.join(above)}\n"
            f"fix: call less, or: python {__file__} --write REASON"
        )


if __name__ == "__main__":
    main()
