"""Find from which commit of its repository needlefit was installed."""

import json
import subprocess
from functools import cache
from importlib.metadata import distribution
from pathlib import Path

GIT_SECONDS = 5.0  # longest time that git is waited for


@cache
def find_source_revision() -> str:
    """Return the commit that needlefit was installed from or that is checked out; empty if neither is known.

    "-dirty" is appended where files of the checkout were changed since.
    """
    origin = json.loads(distribution("needlefit").read_text("direct_url.json") or "{}")
    installed = origin.get("vcs_info", {}).get("commit_id", "")
    checkout = Path(__file__).parents[2]
    if installed or not (checkout / ".git").exists():
        return str(installed)
    command = ("git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):  # no git, or a checkout on a slow disk
        return ""
    return done.stdout.strip()
