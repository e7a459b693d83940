"""How a command fails: what stands on stderr, and the exit code."""

import os
import sys
import traceback

from needlefit.cli.invocation import Invocation
from needlefit.errors import ConfigError, FitError, NeedlefitError

UNEXPECTED, NOT_CONVERGED, VERIFICATION_FAILED, INTERRUPTED = 1, 5, 6, 130

EXIT_CODES = {
    0: "ok",
    UNEXPECTED: "unexpected",
    2: "usage",
    ConfigError.exit_code: "bad data or configuration",
    FitError.exit_code: "the solver failed",
    NOT_CONVERGED: "not converged, or a warning with --strict (result written)",
    VERIFICATION_FAILED: "a verification failed",
    INTERRUPTED: "interrupted",
}


def report(error: BaseException, invocation: Invocation) -> int | None:
    """Say what went wrong and return the exit code; None leaves the error to typer."""
    if isinstance(error, BrokenPipeError):
        _forget_stdout()
        return 0  # the reader has had enough: nothing failed
    if isinstance(error, KeyboardInterrupt):
        print("needlefit: interrupted", file=sys.stderr)
        return INTERRUPTED
    if _is_typers(error):
        return None
    if invocation.verbose:
        traceback.print_exception(error)
    if isinstance(error, OSError):
        error = _of_system(error)
    if isinstance(error, NeedlefitError):
        print(f"needlefit: {error}", file=sys.stderr)
        return error.exit_code
    hint = "" if invocation.verbose else " (-v shows where)"
    print(f"needlefit: unexpected {type(error).__name__}: {error}{hint}", file=sys.stderr)
    return UNEXPECTED


def _of_system(error: OSError) -> ConfigError:
    """Return what the operating system refused as an error that says what to do."""
    return ConfigError(
        f"cannot be read or written: {error.strerror or error}",
        where=str(error.filename or ""),
        expected="a place that exists, with space left, that you may read and write",
        mend="check the path and its permissions, or choose another folder",
    )


def _is_typers(error: BaseException) -> bool:
    """Whether typer itself says how this ends: an exit code, or a usage error that can show itself."""
    return (
        not isinstance(error, Exception)
        or hasattr(error, "show")
        or type(error).__name__ in ("Exit", "Abort")
    )


def _forget_stdout() -> None:
    """Let the flush at the interpreter's end go nowhere instead of failing again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
