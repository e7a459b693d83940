"""A compression test: the curves with their fit, what the fit leaves, and what it says of alpha."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.material import SpecimenFit
from needlefit.inference.population import Material
from needlefit.mechanics.compression import Measure, stress
from needlefit.reporting.figures.style import WIDTH, draw, light_grid
from needlefit.reporting.names import GREY, INK

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")  # Okabe and Ito
_NAMED = 8
"""More specimens than these are not named one by one."""

_FLOOR, _BAR = -8.0, 0.3
"""Log likelihood at which the profiles are cut off; height of a bar below."""


def draw_material(measure: Measure, material: Material, path: Path) -> Path:
    """Draw measured and fitted stress over stretch, residuals below, profile likelihoods of alpha beside."""
    return draw(path, lambda: _paint(measure, material))


def _paint(measure: Measure, material: Material) -> Figure:
    figure = Figure(figsize=(WIDTH, 3.3))
    grid = figure.add_gridspec(2, 2, height_ratios=(2.2, 1), width_ratios=(1.25, 1))
    curves = figure.add_subplot(grid[0, 0])
    left = figure.add_subplot(grid[1, 0], sharex=curves)
    profile = figure.add_subplot(grid[:, 1])
    for n, fit in enumerate(material.fits):
        colour = _COLOURS[n % len(_COLOURS)]
        _draw_curve(curves, fit, colour)
        left.plot(fit.specimen.stretch, 1e3 * fit.residuals, color=colour, lw=0.8)
        _draw_profile(profile, fit, colour, _FLOOR - _BAR * (n + 0.5))
    _dress_curves(curves, left, measure)
    _dress_profile(profile, material)
    if 1 < len(material.fits) <= _NAMED:
        curves.legend(loc="upper left", fontsize=6.5, handlelength=1.2, labelspacing=0.3)
    return figure


def _draw_curve(axes: Axes, fit: SpecimenFit, colour: str) -> None:
    """Draw the measured points, at most some hundred of them, and the fitted curve."""
    at = fit.specimen.stretch
    every = max(1, len(at) // 60)
    axes.plot(
        at[::every], -1e3 * fit.specimen.stress[::every], "o", ms=2.4, mfc="none", mew=0.6, color=colour
    )
    fine = np.linspace(at.min(), min(1.0, at.max()), 200)
    fitted = -1e3 * stress(fit.mu, fit.alpha, fine, fit.measure)
    axes.plot(fine, fitted, color=colour, lw=1.1, label=fit.specimen.name)


def _draw_profile(axes: Axes, fit: SpecimenFit, colour: str, bar: float) -> None:
    """Draw the log likelihood over alpha, and at the height `bar` the 95 % region."""
    likelihood = -0.5 * fit.independent * np.log(fit.profile.ratio)
    axes.plot(fit.profile.alpha, np.where(likelihood >= _FLOOR, likelihood, np.nan), color=colour, lw=1.1)
    for low, high in fit.profile.regions:
        axes.plot([low, high], [bar, bar], color=colour, lw=2, solid_capstyle="butt")


def _dress_curves(curves: Axes, left: Axes, measure: Measure) -> None:
    curves.invert_xaxis()
    curves.tick_params(labelbottom=False)
    curves.set_ylabel(f"{measure} stress (kPa),\npositive in compression")
    left.axhline(0.0, color=INK, lw=0.5)
    left.set_ylabel("fitted minus\nmeasured (kPa)")
    left.set_xlabel("stretch")
    light_grid(curves, "y")
    light_grid(left, "y")


def _dress_profile(axes: Axes, material: Material) -> None:
    axes.set_title("profile log likelihood of α; bars: 95 % region", loc="left")
    axes.set_ylim(_FLOOR - _BAR * (len(material.fits) + 0.5), 0.6)
    ends = [end for fit in material.fits for region in fit.profile.regions for end in region]
    if material.alpha_identified:
        ends += [float(material.mean[1]) + side * material.sds[1] for side in (-1.0, 1.0)]
    margin = 0.5 * (max(ends) - min(ends)) + 0.1
    axes.set_xlim(min(ends) - margin, max(ends) + margin)
    axes.set_xlabel("α")
    if material.alpha_identified:
        mean, sd = float(material.mean[1]), material.sds[1]
        axes.axvspan(mean - sd, mean + sd, color=GREY, alpha=0.2, lw=0, label="prior, ± one sd")
        axes.legend(loc="upper right", fontsize=6.5)
    light_grid(axes, "y")
