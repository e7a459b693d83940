"""Analyses of one target: the study or fit that a record names."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError
from needlefit.project.input_files import is_file
from needlefit.project.locate import find_study_or_fit
from needlefit.project.result_warnings import warnings_entry
from needlefit.project.toml import add_file_context, load
from needlefit.schemas.analyses import TargetRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.schemas.tracks import TrackFitRecord, TrackStudyRecord
from needlefit.studies import provenance
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.run import Run
from needlefit.studies.study_files import load_study


def load_target(target: str) -> tuple[str, FitRecord, Path]:
    """Return the name of the results of a fit, the fit, and the file that it stands in.

    Of a study of tip tracks with several fits, STUDY:FIT names one.

    Raises ConfigError if there is no such study or fit, or it does more than tune.
    """
    study, _, wanted = ("", "", "") if is_file(Path(target)) else target.rpartition(":")
    kind, path = find_study_or_fit(study or target)
    record = load(path, FitRecord) if kind == "fit" else load_study(path)
    if isinstance(record, TrackStudyRecord):
        one = _choose_fit(record, wanted if study else "", path)
        return f"{path.stem}-{one.name}-tune", record.tuning(one), path
    if study:
        find_study_or_fit(target)  # says that there is none of that name
    if kind == "fit" and isinstance(record, FitRecord):
        return path.stem, record, path
    if not isinstance(record, StudyRecord):
        raise ConfigError(
            "is a study that does more than tune, and is not tuned by itself",
            where=str(path),
            fix=f"use: needlefit validate {target}",
        )
    return f"{path.stem}-tune", record.tuning(), path


def _choose_fit(record: TrackStudyRecord, wanted: str, path: Path) -> TrackFitRecord:
    """Return the fit of that name, or the only one."""
    chosen = [one for one in record.fits if one.name == wanted or (not wanted and len(record.fits) == 1)]
    if not chosen:
        raise ConfigError(
            f"is a study of {len(record.fits)} fits" + (f", none of them {wanted}" if wanted else ""),
            where=str(path),
            expected=f"one of {', '.join(f'{path.stem}:{one.name}' for one in record.fits)}",
            fix="name the study and the fit, with a colon between them",
        )
    return chosen[0]


def target_name(record: TargetRecord, settings: Settings) -> str:
    """Return the name of the results of the fit that a record names."""
    given = settings.inputs.target
    return load_target(record.target)[0] if given is None else given[0]


def prepare_target(record: TargetRecord, name: str, settings: Settings) -> Job:
    """Return the work of the fit that a record names; `name` keys its random numbers."""
    if settings.inputs.target is not None:
        return prepare(name, settings.inputs.target[1], settings)
    _, fit, file = load_target(record.target)
    with add_file_context(file):
        return prepare(name, fit, settings)


def prepare_with_held_out(record: TargetRecord, name: str, settings: Settings) -> Job:
    """Return the work of the study that a record names, with what it holds out; of a fit, the fit's."""
    if settings.inputs.target is None:
        kind, path = find_study_or_fit(record.target)
        study = None if kind == "fit" else load_study(path)
        if isinstance(study, StudyRecord):
            with add_file_context(path):
                return prepare(name, study, replace(settings, file=path))
    return prepare_target(record, name, settings)


def begin_run(name: str, record: TargetRecord, job: Job, title: str) -> Run:
    """Return a run without frames: what it is about, and all that decides its result.

    Of a target that was named by its path, the name is kept.
    """
    named = {"target": Path(record.target).stem, "title": record.title or title}
    stored = record.model_copy(update=named)
    work: dict[str, Any] = {
        **provenance.describe_configuration(job),
        "study": stored.model_dump(mode="json", by_alias=True),
        "fit": job.record.model_dump(mode="json", by_alias=True),
        **warnings_entry(job.warnings),
    }
    data = job.dataset
    timing = {"dataset": str(data.path)}
    return Run(str(record.kind), name, stored, data.origin, data.title or data.name, {}, work, timing)
