"""A picture of one simulated scene: the needle in its layers."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from needlefit.errors import ConfigError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, positions

_NEEDLE, _CONSTRAINTS = "#1f4e79", "#c55a11"
_LAYERS = LinearSegmentedColormap.from_list("layers", ["#f6f3ec", "#c9bfa8"])
_METADATA = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def draw_scene(title: str, scene: Scene, shape: NeedleShape, path: Path) -> None:
    """Draw the needle, its layers and its constraint points in C, mm.

    Deflections are small beside depths: the axes have different scales, and their labels say so.

    Raises
    ------
    ConfigError
        If the ending of `path` is none of .png, .pdf and .svg, or its folder does not exist.
    """
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise ConfigError(
            f"cannot draw a `{suffix}`", where=str(path), expected=f"one of {', '.join(_METADATA)}"
        )
    if not path.parent.is_dir():
        raise ConfigError("there is no such folder", where=str(path.parent), mend="make it first")
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _draw_layers(axes, scene)
    _draw_needle(axes, shape)
    state = "" if shape.converged else f" - NOT CONVERGED: {shape.status}"
    axes.set_title(f"{title}{state}", loc="left", fontsize=10)
    axes.set_xlabel("x in the constraint frame, mm")
    axes.set_ylabel("deflection y, mm (enlarged)")
    axes.legend(frameon=False, fontsize=8, loc="best")
    with rc_context({"svg.hashsalt": "needlefit"}):
        figure.savefig(path, dpi=200, metadata=_METADATA[suffix])


def _draw_layers(axes: Axes, scene: Scene) -> None:
    """Shade the layers, the darker the stiffer, and write each one's modulus at the lower edge."""
    end = 1.05 * scene.depth
    edges = np.minimum([0.0, *scene.tissue.boundaries, np.inf], end)
    log_mu = np.log10(scene.tissue.mu)
    shades = (log_mu - log_mu.min()) / max(
        float(np.ptp(log_mu)), 1.0
    )  # a decade at least, from soft to stiff
    for (top, bottom), mu, shade in zip(pairwise(edges), scene.tissue.mu, shades, strict=True):
        if bottom > top:
            axes.axvspan(top, bottom, color=_LAYERS(float(shade)), lw=0, zorder=0)
            axes.text((top + bottom) / 2, 0.02, f"{mu * 1e6:.2g} Pa", ha="center", fontsize=7,
                      transform=axes.get_xaxis_transform())  # fmt: skip
    axes.set_xlim(-0.25 * scene.depth, end)


def _draw_needle(axes: Axes, shape: NeedleShape) -> None:
    s = np.linspace(max(float(shape.x[0]), -0.25 * shape.depth), shape.depth, 400)
    points = positions(shape, s)  # (400, 2)
    axes.plot(points[:, 0], points[:, 1], color=_NEEDLE, lw=2.0, label="needle")
    axes.plot(*shape.constraints.T, ".", color=_CONSTRAINTS, ms=3, label="constraint points")
    axes.axhline(0.0, color="0.5", lw=0.6, ls=":")
