"""Draws of a run's parameters for one further insertion: in which specimen it is, and with which bevel."""

from collections.abc import Callable
from typing import NamedTuple

import pandas as pd

from needlefit.inference.parameter_names import BEVEL_SPREAD, find_bevel_factors
from needlefit.inference.parameters import Parameters
from needlefit.project.locate import unknown_name_error
from needlefit.project.random_streams import random_stream
from needlefit.reporting.table_files import select_rows
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.studies.run import NEW_SPECIMEN, TUNED_SPECIMENS, Run


class InsertionDraws(NamedTuple):
    """Draws of all parameters (Pa, mm, degrees), each with a bevel of its own; None where not certified."""

    specimen: str  #: in which they are, by its name in the table of draws
    table: pd.DataFrame | None


def draw_insertion(
    run: Run,
    fold: str,
    name: str,
    specimen: str,
    chosen: str = "shown",
    find_bevel_sd: Callable[[bool], float] | None = None,
) -> InsertionDraws:
    """Return the draws of a fold for the insertion `name` into a specimen; `chosen`: of a `ViewTarget`.

    `find_bevel_sd`: by how many SDs its bevel deviates, in a new specimen or a known one; by default as the
    run states. ConfigError if there is no specimen of that name.
    """
    stated = run.knows(FitMetadata)
    (tune,) = (one.tune for one in stated.folds if one.name == fold)
    specimens = dict(zip(*(run.frames["errors"][key] for key in ("insertion", "specimen")), strict=True))
    drawn = _choose_specimen(run, specimen, {specimens[one] for one in tune if one in specimens}, chosen)
    draws = select_rows(run.frames["draws"], fold=fold, specimen=drawn)
    if draws.empty or not draws["certified"].all():
        return InsertionDraws(drawn, None)
    sd = find_bevel_sd(drawn == NEW_SPECIMEN) if find_bevel_sd else stated.new_bevel_sd[fold]
    names = [key for key in (*Parameters.from_record(stated.medium).names, BEVEL_SPREAD) if key in draws]
    varied = draws[names].astype(float)
    spreads = varied[BEVEL_SPREAD].to_numpy() if BEVEL_SPREAD in names else 0.0
    deviations = sd * random_stream(stated.recipe.seed, "band", name).standard_normal(len(varied))
    varied[stated.medium.bevel_parameter] *= find_bevel_factors(spreads, deviations)
    return InsertionDraws(drawn, varied)


def _choose_specimen(run: Run, specimen: str, tuned: set[str], chosen: str) -> str:
    """Return in which specimen the draws for an insertion are, by its name in the table of draws."""
    names = {*run.frames["draws"]["specimen"]} - {NEW_SPECIMEN, TUNED_SPECIMENS}
    if chosen not in ("shown", "planned", "new", "same"):
        if chosen not in names & tuned:
            raise unknown_name_error("specimen", chosen, ["new", "same", *(names & tuned)], "")
        return chosen
    differ = run.record.specimens == "others"
    if chosen == "new" or (differ and (chosen == "planned" or specimen not in tuned)):
        return NEW_SPECIMEN if chosen != "same" else TUNED_SPECIMENS
    return specimen if specimen in names else TUNED_SPECIMENS
