"""Figures of results, one file each, drawn in the same way on every machine (`style`)."""

from needlefit.reporting.figures.corner import draw_corner
from needlefit.reporting.figures.held_out_errors import draw_baselines, draw_boxplot
from needlefit.reporting.figures.insertions import draw_overlays, draw_residuals
from needlefit.reporting.figures.predictive_check import draw_predictive_check
from needlefit.reporting.figures.scene import draw_scene
from needlefit.reporting.figures.waterfall import draw_waterfall

__all__ = [
    "draw_baselines",
    "draw_boxplot",
    "draw_corner",
    "draw_overlays",
    "draw_predictive_check",
    "draw_residuals",
    "draw_scene",
    "draw_waterfall",
]
