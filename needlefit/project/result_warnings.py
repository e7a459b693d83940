"""Warnings: what is suspicious about data or a result, though it is read and computed all the same.

A fault stops a run; a warning does not. It is printed under the result, kept under `warnings` in
`run.json`, shown in the report and in `--json`, and with `--strict` it turns the exit code into 5.
"""

import warnings
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

WARNINGS_KEY = "warnings"  # key of the warnings in the output of `--json`


@dataclass(frozen=True)
class ResultWarning:
    """One warning, which is printed on one line."""

    kind: str  # which check it comes from, such as "parameter_at_bound"; programs may rely on it
    what: str  # what was found, in a clause without a full stop
    where: str = ""  # file and line or key, empty if there is none
    fix: str = ""  # what the user can do
    insertions: tuple[str, ...] = ()  # that it is about alone, where the others can be judged without them

    @property
    def help_key(self) -> str:
        """The key of the section of the page on troubleshooting that explains it."""
        return self.kind.replace("_", "-")

    @property
    def help_command(self) -> str:
        """The command that prints this section."""
        return f"needlefit explain {self.help_key}"

    def __str__(self) -> str:
        head = f"{self.where}: {self.what}" if self.where else self.what
        return f"{head}; {self.fix}" if self.fix else head


#: names of open points of a dataset: `needlefit check` prints these warnings in full
OPEN_POINTS = {"placeholder": "texts to fill in", "assumed": "assumptions of the import"}


def condense_open_points(warnings: Iterable[ResultWarning]) -> list[ResultWarning]:
    """Return warnings, of which one takes the place of those about what stays open in a dataset."""
    listed = list(warnings)
    kinds = [kind for kind in OPEN_POINTS if any(warning.kind == kind for warning in listed)]
    if not kinds:
        return listed
    what = f"the dataset has {' and '.join(OPEN_POINTS[kind] for kind in kinds)}"
    open_points = ResultWarning(kinds[-1], what, fix="`needlefit check` lists them")
    return [*(warning for warning in listed if warning.kind not in OPEN_POINTS), open_points]


def to_rows(warnings: Iterable[ResultWarning]) -> list[dict[str, Any]]:
    """Return warnings as JSON values, each once, with the paths that this machine knows."""
    rows = map(asdict, dict.fromkeys(warnings))
    return [{key: value for key, value in row.items() if key != "insertions" or value} for row in rows]


def to_stored_rows(warnings: Iterable[ResultWarning]) -> list[dict[str, Any]]:
    """Return warnings as `run.json` has them; files stand there by their names alone, wherever they lie."""
    return to_rows(replace(warning, where=warning.where.rpartition("/")[2]) for warning in warnings)


def issue_warnings(issued: Iterable[ResultWarning], stacklevel: int = 3) -> None:
    """Issue a UserWarning for each warning; `stacklevel`: as of `warnings.warn`, counted from here."""
    for warning in issued:
        warnings.warn(f"{warning.what}; {warning.fix}", UserWarning, stacklevel)
