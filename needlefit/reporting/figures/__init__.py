"""Figures of results, one file each, drawn the same way on every machine (`style`)."""

from needlefit.reporting.figures.boxplot import boxplot
from needlefit.reporting.figures.corner import corner
from needlefit.reporting.figures.foretold import foretold
from needlefit.reporting.figures.overlays import overlays
from needlefit.reporting.figures.residuals import residuals
from needlefit.reporting.figures.rivals import rivals
from needlefit.reporting.figures.scene import draw_scene
from needlefit.reporting.figures.waterfall import waterfall

__all__ = ["boxplot", "corner", "draw_scene", "foretold", "overlays", "residuals", "rivals", "waterfall"]
