"""Figures whose panels are placed by hand, in mm, so that they can share one scale."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

_INCH = 25.4


def sheet(width: float, height: float) -> Figure:
    """Return an empty figure, mm."""
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    figure.set_layout_engine("none")
    return figure


def panel(figure: Figure, place: tuple[float, float, float, float]) -> Axes:
    """Return axes at (left, bottom, width, height), mm."""
    width, height = figure.get_size_inches() * _INCH
    left, bottom, wide, high = place
    return figure.add_axes((left / width, bottom / height, wide / width, high / height))
