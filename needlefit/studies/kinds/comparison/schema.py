"""The study file of a comparison of models."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.inference.baselines import list_baselines
from needlefit.mechanics.laws import LAWS
from needlefit.schemas.analyses import AnalysisRecord, SyntheticDataRecord
from needlefit.schemas.study import LayerCountRule, SelectionRecord

PATH_ANGLE = "path_angle"
"""The candidate that advances by the path angle, in the tissue law of the medium."""


def _list_default_candidates() -> tuple[str, ...]:
    return ("ogden", "linear", "neo_hookean", *reversed(_list_curves()))


def _list_curves() -> tuple[str, ...]:
    return tuple(baseline.name for baseline in list_baselines() if baseline.has_posterior)


class ComparisonRecord(AnalysisRecord):
    """`kind = "comparison"`: cross-validated comparison of tissue laws and empirical curves."""

    kind: Literal["comparison"]
    dataset: str | None = None
    """Name of a dataset in `data/`, or the path of its folder."""
    synthetic: SyntheticDataRecord | None = None
    """Data simulated for this study, in place of `dataset`."""
    medium: str
    """Name of a tissue model in `configs/media/`: layers and bounds of all laws."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    insertions: SelectionRecord = SelectionRecord()
    """Insertions that are compared."""
    candidates: tuple[str, ...] = Field(default_factory=_list_default_candidates)
    """Tissue laws, "path_angle" (the other rule of advance), and empirical curves."""
    reference: str = "ogden"
    """The candidate that the others are compared with."""
    folds: int = Field(default=4, ge=2)
    """Folds of the cross-validation."""
    positive_control: bool = False
    """Whether the reference must be better than every other candidate for the comparison to count."""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.dataset is None and self.synthetic is None:
            raise ValueError("neither dataset nor [synthetic] is given: give one of them")
        if self.dataset is not None and self.synthetic is not None:
            raise ValueError("both dataset and [synthetic] are given: give one of them")
        known = (*LAWS.names(), PATH_ANGLE, *_list_curves())
        for name in self.candidates:
            if name not in known:
                raise ValueError(f"there is no candidate `{name}`: use some of {', '.join(known)}")
        if self.reference not in self.candidates:
            raise ValueError(f"the reference {self.reference} is not among the candidates")
        return self
