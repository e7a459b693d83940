"""Decide what imported curves and surfaces mean: unit, frame, entry, tissue, layers, pose, bevel, needle."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.dataset_warnings import PLACEHOLDER
from needlefit.datasets.importing.coordinates import convert_units, decide_frame, drop_repeats
from needlefit.datasets.importing.decisions import (
    MAX_ANSWER_CHARS,
    Decisions,
    Question,
    Source,
    parse_positive,
)
from needlefit.datasets.importing.entry_pose import decide_bevel, decide_pose, make_row
from needlefit.datasets.importing.files import ImportContent
from needlefit.datasets.importing.needle import NeedleChoice, decide_needle
from needlefit.datasets.importing.tissue import (
    ImportedLayers,
    cut_at_tissue,
    decide_entry,
    decide_kind,
    decide_layers,
    decide_tissue,
)
from needlefit.datasets.points import Points
from needlefit.datasets.template import PLACEHOLDER_SD_MM
from needlefit.geometry.surfaces import Surface


@dataclass(frozen=True)
class ImportedInsertion:
    """One insertion as it will be written: its row, and its points (N, 3) in mm, entry first."""

    row: InsertionRow
    points: Points


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes.

    Attributes
    ----------
    insertions : tuple of ImportedInsertion
    layers : ImportedLayers
    pose : str
        "known" or "free".
    title, source, license : str
    needle : NeedleChoice
    point_sd_mm : float
    tissue : Surface or None
        The tissue's own surface, at which the curves were cut; it is no boundary of layers.
    """

    insertions: tuple[ImportedInsertion, ...]
    layers: ImportedLayers
    pose: str
    title: str
    source: str
    license: str
    needle: NeedleChoice
    point_sd_mm: float
    tissue: Surface | None = None


def understand(content: ImportContent, decisions: Decisions) -> ImportPlan:
    """Return what the files mean, after every question is settled.

    Raises
    ------
    DataError or ConfigError
        If a question has no clear answer, or the values stated contradict the files.
    """
    reasons: dict[tuple[str, str], list[str]] = {}
    for what, value, why in dict.fromkeys(remark for one in content.curves for remark in one.remarks):
        reasons.setdefault((what, value), []).append(why)
    for (what, value), whys in reasons.items():
        more = f", and {len(whys) - 1} more" if len(whys) > 1 else ""
        decisions.keep(what, value, "guess" if "column" in whys[0] else "file", whys[0] + more)
    curves = [drop_repeats(one, decisions) for one in convert_units(content.curves, decisions)]
    checked = [decide_kind(one, decisions) for one in content.surfaces]
    curves, surfaces = decide_frame(curves, checked, decisions)
    curves = decide_entry(curves, surfaces, decisions)
    tissue = decide_tissue(curves, surfaces, decisions)
    cuts = [cut_at_tissue(one, tissue) for one in curves]
    layers = decide_layers(cuts, [one for one in surfaces if one is not tissue], decisions)
    sd = _decide_point_sd(decisions)
    pose = decide_pose(cuts, layers, sd, decisions)
    bevel = decide_bevel(curves, pose, decisions)
    rows = _name_tissue([make_row(cut, layers, pose, bevel, sd) for cut in cuts], decisions)
    return ImportPlan(
        insertions=tuple(
            ImportedInsertion(row, cut.curve.points) for row, cut in zip(rows, cuts, strict=True)
        ),
        layers=layers,
        pose="free" if pose.how == "free" else "known",
        title=decisions.options.get("title", "") or f"{PLACEHOLDER}: what was inserted into what",
        source=decisions.options.get("source", "") or f"{PLACEHOLDER}: who measured this, when, how",
        license=decisions.options.get("license", "") or PLACEHOLDER,
        needle=decide_needle(max(row.depth for row in rows), decisions),
        point_sd_mm=sd,
        tissue=tissue,
    )


def _decide_point_sd(decisions: Decisions) -> float:
    question = Question("point sd", "Standard deviation of a point across the needle, mm")
    reason = "that of a needle traced in a CT scan"
    return parse_positive(
        question.what, decisions.settle(question, f"{PLACEHOLDER_SD_MM:g}", "assumption", reason)
    )


def _name_tissue(rows: Sequence[InsertionRow], decisions: Decisions) -> list[InsertionRow]:
    """Return the rows with medium and specimen; what a file states for a needle is kept."""
    medium = _settle_name(
        Question("medium", "Name of what was punctured"),
        [row.medium for row in rows],
        ("medium1", "guess", "a name of your choice"),
        decisions,
    )
    specimen = _settle_name(
        Question("specimen", "Specimen of all insertions (`each`: every insertion has its own)"),
        [row.specimen for row in rows],
        ("each", "assumption", "curves of one specimen are never divided between fit and validation"),
        decisions,
    )
    return [
        replace(
            row,
            medium=row.medium or medium,
            specimen=row.specimen or (row.id if specimen == "each" else specimen),
        )
        for row in rows
    ]


def _settle_name(
    question: Question, stated: Sequence[str], guess: tuple[str, Source, str], decisions: Decisions
) -> str:
    """Return the name for the needles of which no file states one."""
    if all(stated):
        listed = ", ".join(dict.fromkeys(stated))
        decisions.keep(question.what, listed[:MAX_ANSWER_CHARS], "file", "a column of the table")
        return ""
    return re.sub(r'[,"]', " ", decisions.settle(question, *guess))
