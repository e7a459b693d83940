"""The kinds of analysis: the study file of each, and the function that runs it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from needlefit.errors import ConfigError
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.json_values import to_json_values
from needlefit.project.load import load, read_toml
from needlefit.project.locate import file_label
from needlefit.project.run_file import read_timing, require_schema
from needlefit.project.threads import one_thread
from needlefit.schemas.analyses import (
    AdaptationRecord,
    AnalysisRecord,
    ComparisonRecord,
    LeftOutRecord,
    SeedsRecord,
    SensitivityRecord,
    SpecimensRecord,
)
from needlefit.schemas.planning import NextInsertionRecord, PlanRecord
from needlefit.schemas.result_files import AnalysisTable
from needlefit.validation.analyses import left_out, sensitivity, specimens
from needlefit.validation.analyses.adaptation import run as adaptation
from needlefit.validation.analyses.comparison import run as comparison
from needlefit.validation.analyses.planning import next_insertion, plan
from needlefit.validation.analyses.runner import AnalysisResult, error_context
from needlefit.validation.analyses.seeds import run as seeds
from needlefit.validation.job import Settings
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack, unpack_frame


@dataclass(frozen=True)
class AnalysisKind:
    """One kind of analysis: the record of its study file, and the function that runs it."""

    record: type[AnalysisRecord]
    run: Callable[[str, Any, Settings], AnalysisResult]


ANALYSIS_KINDS: Mapping[str, AnalysisKind] = MappingProxyType(
    {
        "adaptation": AnalysisKind(AdaptationRecord, adaptation.run),
        "comparison": AnalysisKind(ComparisonRecord, comparison.run),
        "left_out": AnalysisKind(LeftOutRecord, left_out.run),
        "next_insertion": AnalysisKind(NextInsertionRecord, next_insertion.run),
        "plan": AnalysisKind(PlanRecord, plan.run),
        "seeds": AnalysisKind(SeedsRecord, seeds.run),
        "sensitivity": AnalysisKind(SensitivityRecord, sensitivity.run),
        "specimens": AnalysisKind(SpecimensRecord, specimens.run),
    }
)


def load_analysis(path: Path) -> AnalysisRecord | None:
    """Load the analysis of a study file; None if the file has no `kind`, which is a plain study.

    Raises
    ------
    ConfigError
        If the kind is unknown, or the file does not hold what its kind wants.
    """
    kind = read_toml(path).get("kind")
    if kind is None:
        return None
    if not isinstance(kind, str) or kind not in ANALYSIS_KINDS:
        raise ConfigError(
            f"there is no kind of study called {kind!r}",
            where=f"{file_label(path)}, key `kind`",
            expected=f"one of {', '.join(ANALYSIS_KINDS)}, or no `kind`: then it tunes and scores",
        )
    return load(path, ANALYSIS_KINDS[kind].record)


@one_thread
def run(name: str, record: AnalysisRecord, settings: Settings) -> AnalysisResult:
    """Run an analysis.

    The same record, data, seed and versions give the same frames for any number of jobs, and after an
    interruption with `resume`.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    with error_context(name):
        return ANALYSIS_KINDS[record.kind].run(name, record, settings)


_PLAIN = ("name", "origin", "dataset_title", "interrupted", "faults", "run")


def store_result(result: AnalysisResult, folder: Path) -> Path:
    """Write a result without its times to `folder`; equal results give equal bytes."""
    table = {
        "kind": result.kind,
        "record": result.record.model_dump(mode="json", by_alias=True),
        **{key: to_json_values(getattr(result, key)) for key in _PLAIN},
        "frames": {name: pack_frame(frame) for name, frame in result.frames.items()},
    }
    return pack(table, folder)


def is_analysis_result(folder: Path) -> bool:
    """Return whether `folder` holds the result of an analysis."""
    return is_file(folder / RESULTS_FILE) and str(unpack(folder).get("kind")) in ANALYSIS_KINDS


def restore_result(folder: Path) -> AnalysisResult:
    """Read the result of a run from `folder`; DataError if it holds none, or a damaged one."""
    table = unpack(folder)
    require_schema(table, AnalysisTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        return _restore_result(table, folder)


def _restore_result(table: dict[str, Any], folder: Path) -> AnalysisResult:
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    return AnalysisResult(
        record=ANALYSIS_KINDS[table["kind"]].record.model_validate(table["record"]),
        frames={name: unpack_frame(frame) for name, frame in table["frames"].items()},
        timing=read_timing(folder),
        **{**about, "faults": tuple(about["faults"])},
    )
