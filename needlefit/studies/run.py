"""The result of a study: tables, draws, provenance."""

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.inference.sampling.posterior import Posterior
from needlefit.studies.kind import find_kind
from needlefit.studies.verdict import Verdict, judge_run

Frames = MutableMapping[str, pd.DataFrame]

UNVERIFIED_KEY = "unverified"
"""Of `run.json`: files that did not agree with their manifest, and were used on demand."""


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
    origin : "measured", "synthetic" or "none"
        Synthetic as soon as anything in it is; none where it has no data.
    dataset_title : str
        The data, in words.
    frames : mapping of DataFrame
        One row a fact, the unit in every column's name. Those of `ColumnarFrames` are in files.
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
    origin: Literal["measured", "synthetic", "none"]
    dataset_title: str
    frames: Mapping[str, pd.DataFrame] = field(repr=False)
    run: dict[str, Any] = field(repr=False)
    timing: dict[str, Any] = field(repr=False)
    interrupted: bool = False
    faults: tuple[str, ...] = ()
    posteriors: Mapping[str, Posterior] = field(default_factory=dict, repr=False)

    @property
    def run_json(self) -> dict[str, Any]:
        """What `run.json` holds: the kind, and all that decides the result."""
        return {"kind": self.kind, **self.run}

    def with_frames(self, **frames: pd.DataFrame) -> Self:
        """Return the run with some tables replaced."""
        return replace(self, frames={**self.frames, **frames})

    @property
    def title(self) -> str:
        """The title of the report."""
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
        """Whether anything in it is synthetic."""
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
