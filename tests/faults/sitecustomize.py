"""Spoil a step of any Python process: this folder stands first on PYTHONPATH, the step in the environment.

    NEEDLEFIT_FAULT="kill 12 /path/of/the/folder" PYTHONPATH=tests/faults:tests needlefit validate study3

kills it at the 12th step by which it changes that folder; `full` fills the disk from there on, `error` lets
that one step fail. Step 0 is none; with NEEDLEFIT_STEPS=FILE the steps are listed there at the end.
"""

import atexit
import os
import sys
from pathlib import Path

fault = os.environ.pop("NEEDLEFIT_FAULT", "")  # of this process, not of those that it starts
if fault:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from faults.injection import Injector, install

    kind, at, root = fault.split(" ", 2)
    injector = Injector(Path(root).resolve(), int(at), kind)
    install(injector)
    listing = os.environ.get("NEEDLEFIT_STEPS")
    if listing:
        atexit.register(lambda: Path(listing).write_text("\n".join(injector.steps) + "\n"))
