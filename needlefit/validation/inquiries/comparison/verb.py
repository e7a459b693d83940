"""The verb: every candidate is fitted to all folds but one, and foretells that one."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from needlefit.datasets.independent import groups
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.errors import ConfigError
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.comparison import ComparisonRecord
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.medium import MediumRecord
from needlefit.project.records.recipe import RecipeRecord
from needlefit.project.toml_lines import place_of, renamed_keys
from needlefit.validation.folds import Fold
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.answered import Plan, answered
from needlefit.validation.inquiries.blamed import place
from needlefit.validation.inquiries.comparison.against import conclude
from needlefit.validation.inquiries.comparison.candidates import Candidate, candidate, job_of
from needlefit.validation.inquiries.comparison.made import made
from needlefit.validation.inquiries.pieces import Piece, Rows
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.score import Row, Scorer

_WHERE = ("candidate", "fold")
_SCORED = ("depth_mm", "comparison", "converged", "te_mm", "ipe_mean_mm", "floor_te_mm", "floor_ipe_mean_mm")

FRAMES: Mapping[str, tuple[str, ...]] = {
    "scores": (
        *(*_WHERE, "insertion", "group", "points"),
        *("log_density", "log_density_se", "shared_se", "pareto_k", "independent_draws"),
        *_SCORED,
    ),
    "fits": (*_WHERE, "pareto_k", "parameter", "value"),
}
"""`log_density` is of all points of a needle together, in mm^-points; `log_density_se` its Monte Carlo error,
`shared_se` the part of it that is the same for all needles of a fold; `pareto_k` the larger of its two
integrals'."""


def ask(name: str, record: ComparisonRecord, settings: Settings) -> Answer:
    """Carry out a comparison.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    return answered(name, record, settings, plan(record, _job(name, record, settings), settings))


def plan(record: ComparisonRecord, job: Job, settings: Settings) -> Plan:
    """Return the pieces: one for each candidate and fold."""
    jobs = {name: job_of(name, job) for name in record.candidates}
    pieces: dict[str, Piece] = {
        f"{name}, {fold.name}": partial(_piece, name, jobs[name], fold, settings)
        for name in record.candidates
        for fold in job.folds
    }
    parameters = {str(name): each.parameters for name, each in jobs.items()}
    return Plan(tuple(jobs.values()), pieces, FRAMES, partial(conclude, record), parameters=parameters)


def _job(name: str, record: ComparisonRecord, settings: Settings) -> Job:
    table = {"schema": 1, "dataset": record.dataset or name, "medium": record.medium}
    how = {"recipe": record.recipe, "reading": record.reading, "tune": record.insertions}
    fit = FitRecord.model_validate({**table, **how})
    with renamed_keys({"tune": "insertions"}):
        job = prepare(name, fit, settings, _made(name, record, settings))
    if job.recipe.minimize != "posterior":
        raise ConfigError(
            "densities need the errors of the points",
            where=f"study {name}"
            if job.dataset.noise.stated
            else place_of(job.dataset.path, "noise.point_sd_mm"),
            key="recipe" if job.dataset.noise.stated else "",
            expected='a dataset that states its noise, and a recipe with minimize = "posterior"',
        )
    chosen = job.folds[0].tune
    if len(set(_groups(chosen))) < 2:
        raise ConfigError(
            "there is only one group of repeats: none can be left out",
            where=place(name, "folds"),
            key="folds",
            expected="insertions of two groups, at least",
            mend="select more in [insertions]",
        )
    return replace(job, folds=dealt(chosen, record.folds))


def _made(name: str, record: ComparisonRecord, settings: Settings) -> Dataset | None:
    """Return the dataset that the record states itself, None where it names one."""
    if record.made is None:
        return None
    seed = load(find("recipe", record.recipe), RecipeRecord).seed if settings.seed is None else settings.seed
    return made(name, record.made, load(find("medium", record.medium), MediumRecord), seed)


def dealt(insertions: tuple[Insertion, ...], count: int) -> tuple[Fold, ...]:
    """Return folds to which needles, or groups of repeats, are dealt in turn.

    Raises
    ------
    ConfigError
        If there are fewer of these than folds.
    """
    names = _groups(insertions)
    most = len(set(names))
    if count > most:
        raise ConfigError(
            f"{count} folds cannot be dealt from {most} needles, repeats in a specimen counted as one",
            key="folds",
            expected=f"{most} at most",
        )
    order = {name: k % count for k, name in enumerate(dict.fromkeys(names))}
    held = [order[name] for name in names]
    return tuple(
        Fold(
            f"fold {k + 1}",
            tuple(one for one, own in zip(insertions, held, strict=True) if own != k),
            tuple(one for one, own in zip(insertions, held, strict=True) if own == k),
        )
        for k in range(count)
    )


def _groups(insertions: tuple[Insertion, ...]) -> tuple[str, ...]:
    return groups([one.id for one in insertions], [one.specimen for one in insertions])


def _piece(name: str, job: Job, fold: Fold, settings: Settings) -> Rows:
    """Fit one candidate to all folds but one, and ask how probable it makes that one."""
    found = candidate(name, job, fold, settings)
    if found is None:
        return {}
    head: Row = {"candidate": name, "fold": fold.name}
    together = _groups((*fold.tune, *fold.validate))[len(fold.tune) :]
    scores = [
        {**head, "group": group, **_score(job, found, insertion)}
        for insertion, group in zip(fold.validate, together, strict=True)
    ]
    about = {**head, "pareto_k": found.known.k}
    fits = [{**about, "parameter": key, "value": value} for key, value in found.values.items()]
    return {"scores": scores, "fits": fits}


def _score(job: Job, found: Candidate, insertion: Insertion) -> Row:
    """Return how probable the points of a needle are, and the errors of the best curve."""
    floor = job.floor(insertion)
    scorer = Scorer(job.dataset, job.record.reading, {insertion.id: floor})
    scored = scorer.score({}, insertion, found.rival)[0][-1]  # the planned path comes last
    told = found.foretells(insertion)
    return {
        "insertion": insertion.id,
        "points": len(insertion.planar),
        "log_density": told.log_density,
        "log_density_se": told.se,
        "shared_se": told.shared_se,
        "pareto_k": told.k,
        "independent_draws": told.independent,
        **{key: scored[key] for key in _SCORED},
    }
