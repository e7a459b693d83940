"""The study file of a cohort."""

from typing import Literal

from pydantic import Field

from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.study import LayerCountRule, SelectionRecord


class CohortRecord(AnalysisRecord):
    """`kind = "cohort"`: the same fit for each specimen of many datasets."""

    kind: Literal["cohort"]
    datasets: tuple[str, ...] = Field(min_length=1)
    """Datasets: names in `data/`, paths of folders, or patterns of paths such as `"specimens/*"`."""
    medium: str
    """Name of a tissue model in `configs/media/`, or the path of its file."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    tune: SelectionRecord = Field(default=SelectionRecord())
    """Insertions that are fitted, in each dataset."""
    groups: Literal["specimen", "insertion"] = "specimen"
    """What is fitted together."""
