"""What a command knows of its own call: the words typed, and how much it may say."""

import shlex
from dataclasses import dataclass


@dataclass
class Invocation:
    """One call of the program; the options -q, -v and --strict write `quiet`, `verbose` and `strict`.

    `warned` is whether a warning was printed: with `strict` the exit code then is that of no convergence.
    """

    words: tuple[str, ...]
    quiet: bool = False
    verbose: bool = False
    strict: bool = False
    warned: bool = False

    def resuming(self) -> str:
        """Return the command line that goes on where this one stopped."""
        words = self.words if "--resume" in self.words else (*self.words, "--resume")
        return shlex.join(("needlefit", *words))
