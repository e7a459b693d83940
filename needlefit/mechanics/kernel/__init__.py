"""The model of `mechanics/reference.py`, compiled; a test ties the two.

`insertion` goes from stop to stop; at each `grid` says what is met, `scalar` finds the equilibrium and
`foundation` evaluates the tissue's law; `positions` lays the beam in the plane. `lanes/` does the same for
many parameter sets at once, `sensitivity/` adds exact derivatives.

Numba keeps compiled functions on disk and tells whether one is stale by the file that it stands in alone,
not by the files that it calls. Kept in a folder named after all sources of this package, no stale one is
ever run, whichever file changed and whatever time an installer gave it.
"""

import hashlib
import importlib
import os
import pkgutil
from pathlib import Path
from typing import Any

import numba


def _cache_folder() -> Path:
    """Return the folder of the compiled functions of exactly these sources."""
    here = Path(__file__).parent
    sources = b"".join(path.name.encode() + path.read_bytes() for path in sorted(here.rglob("*.py")))
    caches = os.environ.get("NUMBA_CACHE_DIR") or Path(
        os.environ.get("XDG_CACHE_HOME") or "~/.cache", "needlefit"
    )
    return Path(caches).expanduser() / hashlib.sha256(sources).hexdigest()[:16]


_folder = _cache_folder()


def compiled(room: str) -> bool:
    """Return whether what moves a needle in a room (kernel, lanes, sensitivity) stands compiled on disk."""
    return any(_folder.glob(f"{room}_*/insertion.advance*.nbi"))


_config: Any = numba.config  # a module that makes its attributes at run time
_before, _config.CACHE_DIR = _config.CACHE_DIR, str(_folder)
try:  # numba reads the setting when a function is declared
    for _module in pkgutil.walk_packages(__path__, f"{__name__}."):
        importlib.import_module(_module.name)
finally:
    _config.CACHE_DIR = _before
