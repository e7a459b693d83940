"""Figures of fits and cross-validations."""

from needlefit.studies.kinds.cross_validation.figures.corner import draw_corner
from needlefit.studies.kinds.cross_validation.figures.held_out_errors import draw_baselines, draw_boxplot
from needlefit.studies.kinds.cross_validation.figures.insertions import (
    draw_overlays,
    draw_residuals,
    draw_schematic,
)
from needlefit.studies.kinds.cross_validation.figures.predictive_check import draw_predictive_check
from needlefit.studies.kinds.cross_validation.figures.waterfall import draw_waterfall

__all__ = [
    "draw_baselines",
    "draw_boxplot",
    "draw_corner",
    "draw_overlays",
    "draw_predictive_check",
    "draw_residuals",
    "draw_schematic",
    "draw_waterfall",
]
