"""What a command knows of its own call: the words typed, and how much it may say."""

import shlex
from dataclasses import dataclass


@dataclass
class Invocation:
    """One call of the program; the options -q and -v write `quiet` and `verbose`."""

    words: tuple[str, ...]
    quiet: bool = False
    verbose: bool = False

    def resuming(self) -> str:
        """Return the command line that goes on where this one stopped."""
        words = self.words if "--resume" in self.words else (*self.words, "--resume")
        return shlex.join(("needlefit", *words))
