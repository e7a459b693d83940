"""Runs that predict by few draws or draw empty figures, for tests of neither predictions nor figures."""

from functools import partial

from matplotlib.figure import Figure

from needlefit.inference import curve_bands
from needlefit.inference.sampling.importance import EFFORT, sample_about_fit
from needlefit.reporting.figures import style
from needlefit.studies import fold_draws

DRAWS, CURVES = 50, 100


def predict_by_few_draws(patch):
    patch.setattr(fold_draws, "PREDICTION_DRAWS", DRAWS)
    patch.setattr(curve_bands, "DRAWN_CURVES", CURVES)


def do_not_escalate(patch):
    """Leave draws that are not certified as they are: no more of them, and no sampler."""
    patch.setattr(fold_draws, "sample_about_fit", partial(sample_about_fit, efforts=(EFFORT,)))
    patch.setattr(fold_draws, "sample_posterior", lambda *_: None)


def draw_blank(patch):
    """Let every figure be saved empty; the table lies beside it as always.

    Saving is what takes the time. `style.draw` is left as it is: a module that is first loaded while it is
    replaced would keep the replacement for the tests that follow.
    """
    save = style.save_figure
    patch.setattr(style, "save_figure", lambda _, suffix, *__: save(Figure(figsize=(1, 1)), suffix))
