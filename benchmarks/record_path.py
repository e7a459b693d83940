"""Count the modules of needlefit that the record of a study enters while the study is run and reported.

    python benchmarks/record_path.py study3

The record is what the TOML file of the study becomes. A module counts when one of its functions is called, in
the process of the command, with the record as an argument, or with a dataclass that has it as its `record`.
"""

import argparse
import sys
import tempfile
import threading
from collections import Counter
from dataclasses import is_dataclass

from needlefit.cli import main as run_command
from needlefit.schemas.base import FileRecord


class RecordPath:
    """Counts, by module, the calls whose arguments include a record of one type."""

    def __init__(self, record_type):
        self.record_type = record_type
        self.calls = Counter()

    def __call__(self, frame, event, _):
        """Note a call; the signature is that of `sys.setprofile`."""
        module = frame.f_globals.get("__name__", "")
        if event != "call" or not module.startswith("needlefit.") or module.startswith("needlefit.schemas"):
            return
        code = frame.f_code
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(self._holds_record(frame.f_locals.get(name)) for name in names):
            self.calls[module] += 1

    def _holds_record(self, value):
        if is_dataclass(value) and not isinstance(value, type):
            value = getattr(value, "record", None)
        return isinstance(value, self.record_type)


def main():
    """Run one study in a temporary folder and print the modules that its record entered, in their order."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", nargs="?", default="study3")
    study = parser.parse_args().study
    from needlefit.studies.kind import KINDS

    records = tuple(kind.record for kind in KINDS.values() if issubclass(kind.record, FileRecord))
    path = RecordPath(records)
    with tempfile.TemporaryDirectory() as folder:
        sys.setprofile(path)
        threading.setprofile(path)
        try:
            run_command(["validate", study, "--quiet", "--out", folder])
        except SystemExit as end:
            if end.code not in (0, None):
                raise
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
    for module, calls in path.calls.items():
        print(f"{calls:6d}  {module}")
    print(f"{len(path.calls)} modules")


if __name__ == "__main__":
    main()
