"""The result of a study: tables, draws, verdicts, and what a reader needs to repeat it."""

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import update_wrapper
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec, Self, TypeVar

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.inference.sampling.posterior import Posterior
from needlefit.reporting.text import KindText
from needlefit.studies.kind import find_kind

Status = Literal["none", "pass", "warn", "fail"]
#: from the best to the worst; "none" where nothing was tested, as of a prediction: it has no badge
STATUSES: tuple[Status, ...] = ("none", "pass", "warn", "fail")

VERDICTS_KEY = "verdicts"  #: of `--json`

Given = ParamSpec("Given")
Value = TypeVar("Value")


def once_per_run(
    derive: Callable[Concatenate["Run", Given], Value],
) -> Callable[Concatenate["Run", Given], Value]:
    """Return `derive`, computed once for each run and (hashable) arguments; nobody may change its value.

    Tables, figures, sentences and verdicts of a report ask for the same.
    """

    def find(result: "Run", /, *args: Given.args, **kwargs: Given.kwargs) -> Value:
        key = (derive.__module__, derive.__qualname__, args, *kwargs.items())
        if key not in result.derived:
            result.derived[key] = derive(result, *args, **kwargs)
        found: Value = result.derived[key]
        return found

    update_wrapper(find, derive)
    return find


@dataclass(frozen=True)
class Verdict:
    """The answer for one group of insertions, or for a whole run."""

    sentence: str  #: the answer, with its most important numbers
    #: whether the result can be relied on, only with care, or not; "none" where this was not tested
    status: Status = "pass"
    group: str = ""  #: what it is about, such as "phantom 1, 3 layers"; empty: the whole run
    #: the numbers behind the sentence, by name with unit; None where one is not known
    numbers: Mapping[str, float | str | None] = field(default_factory=dict)


NOT_CONVERGED = "NOT CONVERGED"


def headline_fault(fault: str) -> str:
    """Return what stands before the verdicts of a run with this fault."""
    if "not certified" in fault:
        return "NOT CERTIFIED"
    return "INCOMPLETE" if fault.endswith(("could not be predicted", "have no density")) else NOT_CONVERGED


def mark_faults(faults: Sequence[str], headline: Callable[[str], str] = headline_fault) -> str:
    """Return the headlines of faults, each once, as sentences that stand before a result; "" without any."""
    return "".join(dict.fromkeys(f"{head}. " for head in map(headline, faults) if head))


@once_per_run
def judge_run(result: "Run") -> tuple[Verdict, ...]:
    """Return the verdicts of a run, one for each group, from its stored tables alone.

    A run that was interrupted, or that has faults, passes nowhere; the headlines of its faults come first.
    Those of a preliminary recipe are marked. Of what the import of its data assumed the most decisive is
    named, with the place of the others.
    """
    report = find_kind(result.kind).report
    verdicts = report.judge(result)
    if assumed := (result.run.get("dataset") or {}).get("assumed"):
        more = f" and {len(assumed) - 1} more ([import] in dataset.toml)" if len(assumed) > 1 else ""
        named = f"; assumed at the import: {assumed[0]}{more}"
        verdicts = [replace(one, sentence=f"{one.sentence}{named}") for one in verdicts]
    if (result.run.get("recipe") or {}).get("preliminary"):
        recipe = Path(str(getattr(result.record, "recipe", ""))).stem
        mark = f"; preliminary (recipe {recipe})" if recipe else "; preliminary"
        verdicts = [replace(one, sentence=f"{one.sentence}{mark}") for one in verdicts]
    if result.interrupted:
        return tuple(qualify(one, f"INTERRUPTED: the best found so far. {one.sentence}") for one in verdicts)
    if result.faults:
        heads = mark_faults(result.faults, report.headline)
        return tuple(qualify(one, f"{heads}{one.sentence}") for one in verdicts)
    return tuple(verdicts)


#: tip error over its noise floor up to which predictions are as exact as the measurements
MAX_FLOOR_RATIO = 2.0


#: held-out insertions with which a verdict can pass: the mean of one or two says little about others
MIN_INSERTIONS = 3


@dataclass(frozen=True)
class BestBaseline:
    """The baseline with the smallest tip error: in words, its error (mm), and how it compares with the fit.

    `verdict` is "better", "worse", or "tie" where the difference is not significant.
    """

    description: str
    error_mm: float | None
    verdict: Literal["better", "worse", "tie"]


def judge_errors(
    where: str,
    error_mm: float,
    floor_ratio: float | None,
    best: BestBaseline | None,
    insertions: int,
    *,
    reliable: bool = True,
) -> Verdict:
    """Judge the mean tip error of predictions on `where` beside the noise floor and the best baseline.

    Only `MIN_INSERTIONS` held out, with no baseline closer, can pass; and only `reliable` results, those of a
    run that is complete and without faults.
    """
    few = insertions < MIN_INSERTIONS
    opening, compared = _compare(error_mm, floor_ratio, best)
    if (few or not reliable) and opening != "fail":
        opening = "open"
    values = {"opening": opening, "compared": compared, "error_mm": error_mm, "floor_ratio": floor_ratio}
    values |= {"where": where, "insertions": insertions, "few": few, "best": best}
    status: Status = opening if opening in ("pass", "fail") else "warn"
    return Verdict(KindText("verdicts").sentence("errors", values), status)


Opening = Literal["pass", "part", "open", "fail"]  #: generalises; in part; not shown to; does not


def _compare(error_mm: float, floor_ratio: float | None, best: BestBaseline | None) -> tuple[Opening, str]:
    """Return the opening of a verdict, and how the best baseline compares.

    Within the noise floor a difference is not significant, whatever its standard error.
    """
    better_than_all: Opening = "pass" if floor_ratio is None or floor_ratio <= MAX_FLOOR_RATIO else "part"
    if best is None:
        return better_than_all, ""
    within_floor = floor_ratio is not None and floor_ratio <= 1
    if best.verdict == "better" and not within_floor:
        return "fail", "better"
    if best.error_mm is not None and best.error_mm < error_mm:
        return "open", "within floor" if best.verdict == "better" else "closer"
    return (better_than_all, "worse") if best.verdict == "worse" or within_floor else ("open", "tie")


def qualify(verdict: Verdict, sentence: str) -> Verdict:
    """Return a verdict in other words that does not pass: "warn" at best."""
    return replace(verdict, sentence=sentence, status=worst_status([verdict, Verdict("", "warn")]))


def worst_status(verdicts: Sequence[Verdict]) -> Status:
    """Return the worst status of several verdicts; "pass" of none."""
    return max((one.status for one in verdicts), key=STATUSES.index, default="pass")


def verdicts_to_json(verdicts: Sequence[Verdict]) -> list[dict[str, object]]:
    return [asdict(one) for one in verdicts]


Frames = MutableMapping[str, pd.DataFrame]

#: of `run.json`: files that did not agree with their manifest, and were used on demand
UNVERIFIED_KEY = "unverified"


@dataclass(frozen=True)
class Run:
    """The result of a study of any kind: tables, draws, provenance and faults.

    Attributes
    ----------
    kind : str
        Of study: which folder of `kinds` ran it and reports it.
    name : str
        Of the run.
    record : FileRecord
        The study file, or the options that stand for one.
    origin : "measured" or "synthetic"
        Synthetic as soon as anything in it is.
    dataset_title : str
        The data, in words.
    frames : mapping of DataFrame
        One row a fact, the unit in every column's name.
    run : dict
        All that decides the result (versions, data, configuration, rules); no time and no path.
    timing : dict
        Seconds, jobs, paths.
    interrupted : bool
        Whether some of the work was left undone.
    faults : tuple of str
        Why something in it is not to be trusted.
    posteriors : mapping
        Sampled posteriors, by name of the fit or fold.
    """

    kind: str
    name: str
    record: Any = field(repr=False)
    origin: Literal["measured", "synthetic"]
    dataset_title: str
    frames: Mapping[str, pd.DataFrame] = field(repr=False)
    run: dict[str, Any] = field(repr=False)
    timing: dict[str, Any] = field(repr=False)
    interrupted: bool = False
    faults: tuple[str, ...] = ()
    posteriors: Mapping[str, Posterior] = field(default_factory=dict, repr=False)
    #: what `once_per_run` keeps
    derived: dict[object, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def run_json(self) -> dict[str, Any]:
        """What `run.json` holds: the kind, and all that decides the result."""
        return {"kind": self.kind, **self.run}

    def with_frames(self, **frames: pd.DataFrame) -> Self:
        """Return the run with some tables replaced."""
        return replace(self, frames={**self.frames, **frames})

    @property
    def title(self) -> str:
        return str(getattr(self.record, "title", "") or self.name)

    @property
    def question(self) -> str:
        """What the study asks."""
        return str(getattr(self.record, "question", ""))

    @property
    def note(self) -> str:
        """What a reader of the study must know."""
        return str(getattr(self.record, "note", ""))

    @property
    def synthetic(self) -> bool:
        return self.origin == "synthetic"

    @property
    def unverified(self) -> tuple[str, ...]:
        """What did not agree with the manifest of the folder that it was read from; every page says so."""
        return tuple(self.run.get(UNVERIFIED_KEY, ()))

    @property
    def reliable(self) -> bool:
        """Whether it is complete and without faults."""
        return not (self.interrupted or self.faults)

    @property
    def posterior(self) -> Posterior:
        """The sampled posterior; ConfigError where none, or one of each of several folds, was sampled."""
        if len(self.posteriors) == 1:
            return next(iter(self.posteriors.values()))
        several = ", ".join(map(repr, self.posteriors))
        raise ConfigError(
            f"`{self.name}` has {'several posteriors' if several else 'no sampled posterior'}",
            fix=f"name one: run.posteriors[...] with {several}" if several else "use: needlefit.sample(run)",
        )

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The answer in one sentence for each group, with its status and numbers."""
        return judge_run(self)

    def save(self, folder: Path | str) -> Path:
        """Write tables (CSV, LaTeX), figures, report and all that `load_run` reads to `folder`; return it.

        Raises
        ------
        ConfigError
            If `folder` holds anything that needlefit did not write, or that was changed since.
        """
        return find_kind(self.kind).report.write(self, Path(folder))

    def _repr_html_(self) -> str:
        return find_kind(self.kind).report.format_notebook_html(self)
