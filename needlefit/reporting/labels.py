"""Printed names and colours of methods, media and groups, and the captions of figures."""

from needlefit.inference.baselines import BASELINES, list_baselines
from needlefit.mechanics.laws import LAWS

INK, GREY, PAPER_COLOUR, SYNTHETIC_COLOUR = "#1a1a1a", "#8a8a8a", "#D55E00", "#B23A00"
GREEN, SKY_BLUE = "#009E73", "#56B4E9"

METHOD_NAMES = {
    "fitted": "posterior-mode fit",
    "fitted_metric": "error-minimising fit",
    "hand_tuned": "paper's parameters",
    "hand_tuned_b": "paper's parameters, b re-fitted",
    "truth": "true parameters of the synthetic data",
    "path_angle": "advance by the path angle",
}
METHOD_COLOURS = {  # Okabe and Ito's palette, distinguishable for colour-blind readers
    "fitted": "#0072B2",
    "fitted_metric": "#0A2F4A",
    "hand_tuned": "#E69F00",
    "hand_tuned_b": "#CC79A7",
    "truth": "#1a1a1a",
}
"""Colours of methods that are no baseline; `method_colour` knows those too."""
_MODEL_MARKERS = {"fitted": "o", "fitted_metric": "o", "hand_tuned": "s", "hand_tuned_b": "s"}
_BASELINE_MARKERS = "v^D<>phX*"
APPROACH_NAMES = {
    "inflated": "old posterior, widened",
    "new": "new insertions alone",
    "none": "no update",
}
"""Printed names of the ways to fit a new medium in an adaptation."""
SERIES_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
"""Of series without a colour of their own (Okabe and Ito)."""

APPROACH_COLOURS = {"inflated": "#0072B2", "new": "#009E73", "none": "#8a8a8a"}
PLAN_NAMES = {
    "expected": "least expected squared miss",
    "best_fit": "posterior mode, no uncertainty",
    "hand_tuned": METHOD_NAMES["hand_tuned"],
    "straight": "straight line to the target",
}
PLAN_COLOURS = {
    "expected": METHOD_COLOURS["fitted"],
    "best_fit": "#CC79A7",
    "hand_tuned": METHOD_COLOURS["hand_tuned"],
    "straight": GREY,
}
SPECIMEN_NAMES = {
    "others": "new specimen",
    "one insertion": "new specimen, after one insertion",
    "same": "same specimen",
    "training only": "training only",
}
"""Printed values of the column `specimen_treatment`."""
POPULATION_NAMES = {"mean": "mean", "spread": "spread", "new": "further specimen"}
"""Quantities of a parameter of a population of specimens."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, each 0 to 1, of a colour "#rrggbb"."""
    red, green, blue = (round(int(colour[i : i + 2], 16) / 255, 6) for i in (1, 3, 5))
    return red, green, blue


SYNTHETIC_NOTE = (
    "Synthetic data: agreement with the paper shows consistency and is no evidence for the model, because "
    "the dataset was built from the paper's design, moduli and deflections."
)


def medium_name(name: str) -> str:
    """Return the printed name of a medium: `phantom2` becomes "phantom 2"."""
    stem = name.rstrip("0123456789")
    return f"{stem} {name[len(stem) :]}".strip().replace("_", " ")


def study_name(label: str | int) -> str:
    """Return the printed name of a study: "study 3" for the paper's third; other studies keep their names."""
    return f"study {label}" if isinstance(label, int) else str(label)


def layers_name(layers: int) -> str:
    """Return a number of layers as text: "1 layer", "3 layers"."""
    return f"{layers} layer" if layers == 1 else f"{layers} layers"


def group_name(medium: str, layers: int) -> str:
    """Return the printed name of the insertions across so many layers of a medium: "phantom 1 (3 layers)"."""
    return f"{medium_name(medium)} ({layers_name(layers)})"


def entry_name(entry: str, angle_deg: float) -> str:
    """Return the printed name of an entry and an angle."""
    return entry if angle_deg == 0 else f"{entry}, {angle_deg:g}°".replace("-", "−")


def method_colour(method: str) -> str:
    """Return the colour of a method's lines and marks; grey for one that is not registered here."""
    return BASELINES[method].colour if method in BASELINES else METHOD_COLOURS.get(method, GREY)


def method_marker(method: str) -> str:
    """Return the marker of a method in figures."""
    names = [baseline.name for baseline in list_baselines()]
    if method in names:
        return _BASELINE_MARKERS[names.index(method) % len(_BASELINE_MARKERS)]
    return _MODEL_MARKERS.get(method, "o")


def candidate_name(name: str) -> str:
    """Return the printed name of a candidate of a comparison, a tissue law or a baseline."""
    return LAWS[name].label if name in LAWS else method_name(name)


def method_name(method: str, origin: str = "measured") -> str:
    """Return the printed name of a method; on synthetic data the paper's parameters were not tuned on these
    data.
    """
    name = BASELINES[method].label if method in BASELINES else METHOD_NAMES.get(method, method)
    foreign = method == "hand_tuned" and origin == "synthetic"
    return f"{name} (not tuned on this data)" if foreign else name


BOXPLOT_CAPTION = (
    "Errors on held-out insertions: all points (IPE), all tips (TE; no box for fewer than five). Boxes: "
    "quartiles; whiskers: 5th to 95th percentile. Diamonds: means over insertions."
)
PAPER_MEANS_CAPTION = "The paper’s means (open) are of its own needles."
SCHEMATIC_CAPTION = (
    "Insertions with the smallest and the largest tip error (TE): measured needle (dots) and model (line). "
    "The orange line joins the two tips: its length is the TE. Shaded: layers, with their numbers."
)
OVERLAYS_CAPTION = (
    "Measured needles (dots) and model (lines), one panel per insertion, all with the same axes. Number: tip "
    "error."
)
RESIDUALS_CAPTION = (
    "Deflection minus that of the fitted needle at the same depth, positive toward the bevel: insertions "
    "with the smallest, the median and the largest tip error. The straight line is not drawn; curves that "
    "leave a panel lie farther away."
)
BANDS_CAPTION = (
    "Bands: 50 % and 95 % predictive bands of held-out insertions. They include the uncertainty of the "
    "parameters and the measurement errors, so they need not be centred on the fit. Bands that leave a panel "
    "are wider."
)
NO_BANDS_CAPTION = "Predictive bands are not drawn: the draws are not certified or not converged."
WATERFALL_CAPTION = (
    "Waterfall plot. Left: objective of each start minus the best one of its search, sorted, in units of the "
    "tolerance (dashed): 0.1 of the log posterior, or 1 % of the metric objective and at least 0.002 mm. "
    "Starts closer than 0.001 are drawn there. Right: final value of each free parameter between its bounds "
    "(written at the ends; μ, b and θ in logarithms)."
)
CORNER_CAPTION = (
    "Posterior: marginals and pairs; moduli, b and θ in logarithms. Dots and histograms: draws. Lines and "
    "marks as in the legend. Dotted: bounds, and the flat prior between them."
)
PREDICTIVE_CHECK_CAPTION = (
    "Predictive check. Left: empirical CDF of the predictive CDF at the measurement (PIT); well-calibrated "
    "predictions stay in the grey band in 95 % of cases. Right: share of insertions inside their 50 % and "
    "95 % intervals, with its 95 % confidence interval (Wilson)."
)
RANKS_CAPTION = (
    "Simulation-based calibration: ECDF of the rank of the truth among posterior draws minus that of uniform "
    "ranks, for each quantity. Grey: simultaneous confidence band of uniform ranks. Above and then below: "
    "posteriors too narrow; below and then above: too wide."
)
PROFILES_CAPTION = (
    "Profile likelihoods: deviance with one parameter fixed and all others fitted again (solid; dots were "
    "computed). Shaded and written above: the 95 % interval of the tables. It is that of the posterior draws "
    "where they are certified, so it need not end where the profile crosses the dashed line. A curve that "
    "stays under this line up to a bound does not limit the parameter on that side. Dashed curve: the Fisher "
    "information at the optimum. Flat profiles of fixed parameters are not drawn."
)
BASELINES_CAPTION = (
    "Mean in-plane error of the fitted model and of the baselines on the same held-out points (logarithmic "
    "axis); lower is better. Dashed: noise floor."
)
