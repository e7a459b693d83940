"""Figures as forms over tidy frames (`forms`), drawn in the same way on every machine (`style`)."""

from needlefit.reporting.figures.drawing import Drawing
from needlefit.reporting.figures.looks import Look, Panel

__all__ = ["Drawing", "Look", "Panel"]
