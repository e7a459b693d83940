"""How a command fails: what stands on stderr, and the exit code."""

import sys
import traceback

from needlefit.cli.invocation import Invocation
from needlefit.errors import ConfigError, FitError, NeedlefitError, printable

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
    if isinstance(error, KeyboardInterrupt):
        print("needlefit: interrupted", file=sys.stderr)
        return INTERRUPTED
    if _is_typers(error):
        return None
    if invocation.verbose:
        traceback.print_exception(error)
    error = _explained(error)
    if isinstance(error, NeedlefitError):
        print(f"needlefit: {error}", file=sys.stderr)
        return error.exit_code
    hint = "" if invocation.verbose else " (-v shows where)"
    print(f"needlefit: unexpected {type(error).__name__}: {error}{hint}", file=sys.stderr)
    return UNEXPECTED


def make_printable(error: BaseException) -> None:
    """Escape control characters in the message of a usage error, which repeats the words that were typed."""
    message = getattr(error, "message", None)
    if hasattr(error, "show") and isinstance(message, str):
        error.message = printable(message)  # type: ignore[attr-defined]


def _explained(error: BaseException) -> BaseException:
    """Return an error of Python's of which it is known what a user can do, as one that says so."""
    if isinstance(error, OSError):
        return _of_system(error)
    if isinstance(error, MemoryError):
        return ConfigError(
            "there is not enough memory for this",
            expected="inputs and results that fit into the memory of this machine",
            mend="use fewer --jobs, smaller or fewer inputs, or a machine with more memory",
        )
    if isinstance(error, RecursionError):
        return ConfigError(
            "an input is nested too deeply", expected="a few levels", mend="check the files that were named"
        )
    if isinstance(error, UnicodeEncodeError):
        return ConfigError(
            "a name or text holds characters that are not valid Unicode",
            where=ascii(error.object[max(error.start - 40, 0) : error.end + 40]),
            expected="names of files, folders and data that can be written as UTF-8",
            mend="rename it",
        )
    return error


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
