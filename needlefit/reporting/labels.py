"""Printed names and colours of methods, media and groups, and the captions of figures."""

from needlefit.validation.results import Results

INK, GREY, PAPER_COLOUR, SYNTHETIC_COLOUR = "#1a1a1a", "#8a8a8a", "#D55E00", "#B23A00"

METHOD_NAMES = {
    "fitted": "needlefit, fitted",
    "fitted_metric": "fitted to IPE, TE, EDP",
    "hand_tuned": "paper's hand-tuned set",
    "hand_tuned_b": "hand-tuned set, b re-tuned",
    "straight": "straight line",
    "constant_curvature": "constant curvature",
    "linear_curvature": "curvature linear in arc length",
    "truth": "the twin’s own parameters",
}
METHOD_COLOURS = {  # Okabe and Ito's palette, distinguishable for colour-blind readers
    "fitted": "#0072B2",
    "fitted_metric": "#0A2F4A",
    "hand_tuned": "#E69F00",
    "hand_tuned_b": "#CC79A7",
    "straight": "#8a8a8a",
    "constant_curvature": "#009E73",
    "linear_curvature": "#56B4E9",
    "truth": "#1a1a1a",
}
CANDIDATE_NAMES = {
    "ogden": "Ogden foundation",
    "linear": "linear foundation",
    "neo_hookean": "neo-Hookean foundation",
    **{name: METHOD_NAMES[name] for name in ("linear_curvature", "constant_curvature", "straight")},
}
APPROACH_NAMES = {
    "inflated": "old posterior, inflated",
    "new": "new insertions alone",
    "none": "no update",
}
"""Printed names of the ways to learn a new medium in an adaptation."""
APPROACH_COLOURS = {"inflated": "#0072B2", "new": "#009E73", "none": "#8a8a8a"}
PLAN_NAMES = {
    "expected": "least expected squared miss",
    "best_fit": "best fit, taken for certain",
    "hand_tuned": METHOD_NAMES["hand_tuned"],
    "straight": "straight at the target",
}
PLAN_COLOURS = {
    "expected": METHOD_COLOURS["fitted"],
    "best_fit": "#CC79A7",
    "hand_tuned": METHOD_COLOURS["hand_tuned"],
    "straight": METHOD_COLOURS["straight"],
}
POPULATION_NAMES = {"mean": "mean", "spread": "spread", "new": "a further one"}
"""Quantities of a parameter of a population of specimens."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, each 0 to 1, of a colour "#rrggbb"."""
    red, green, blue = (round(int(colour[i : i + 2], 16) / 255, 6) for i in (1, 3, 5))
    return red, green, blue


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


def entry_name(entry: str, angle_deg: float) -> str:
    """Return the printed name of an entry and an angle."""
    return entry if angle_deg == 0 else f"{entry}, {angle_deg:g}°".replace("-", "−")


def method_name(method: str, results: Results) -> str:
    """Return the printed name of a method; on synthetic data the paper's parameters were not tuned on these
    data.
    """
    name = METHOD_NAMES.get(method, method)
    foreign = method == "hand_tuned" and results.origin == "synthetic"
    return f"{name} (not tuned on this data)" if foreign else name


BOXPLOT_CAPTION = (
    "Errors on held-out insertions. Boxes span the quartiles and whiskers the 5th to the 95th percentile, of "
    "the in-plane errors of all points and of the tip errors; tips of fewer than five insertions are shown "
    "as points alone. Filled diamonds are our means over insertions, open ones the paper’s on its own "
    "needles, dashes the noise floor’s."
)
OVERLAYS_CAPTION = (
    "Measured needles (dots) and what the model makes of them (lines), one panel per insertion, all in the "
    "same axes, depth and deflection to the same scale. Bands: where 50 and 95 % of measurements of a "
    "held-out needle were predicted to lie. Deflection is positive toward the bevel. Above each panel stand "
    "its errors."
)
RESIDUALS_CAPTION = (
    "What needles drawn to scale hide: deflection less that of the fitted needle at the same depth, positive "
    "toward the bevel; stretched freely, for it is no geometry. Bands as above: they are of draws of the "
    "posterior, with the errors of measurement, along the layers that each draw would meet, and need not lie "
    "about the fit. Curves that leave a panel lie farther off; the straight line is left out."
)
WATERFALL_CAPTION = (
    "Left: how far each start of a search ended above its best, best first, in units of what still counts as "
    "practically as good (dashed): 0.1 of the log posterior, or 1 % of the metric objective and at least "
    "0.002 mm. Right: where the starts left each free parameter between its bounds (written at the ends; μ "
    "and b in logarithms). Filled dots spread along the axis mean that the data do not determine it."
)
CORNER_CAPTION = (
    "The posterior, one parameter and one pair at a time; moduli and b in logarithms. Draws (dots, and their "
    "histograms), the fit and the paper’s set; dotted, the bounds and what the flat prior between them would "
    "have the histograms be."
)
PREDICTIVE_CHECK_CAPTION = (
    "Whether held-out needles came out as predicted. Left: the share of needles whose level is at most so "
    "high; a level is the probability predicted of a tip less far toward the bevel, or of a shape nearer at "
    "its worst point. Right predictions stay in the grey band throughout, but for 5 %. Right: what share of "
    "needles the 50 and 95 % intervals held, with Wilson’s interval of so few trials; a needle is one trial, "
    "and repeats in one specimen are one where there are specimens enough."
)
RANKS_CAPTION = (
    "Where truths stood among draws of their posteriors: the ECDF of the ranks of each quantity, less that "
    "of uniform ones, on the band in which chance keeps it. First above and then below, posteriors are too "
    "narrow; the other way round, too wide."
)
CONVERGENCE_CAPTION = (
    "Manufactured solutions: largest error in the tissue under refinement, per case. Dashed: the orders that "
    "theory promises. “At the nodes”: the largest of all cases there alone, where the slope superconverges."
)
PROFILES_CAPTION = (
    "Profile likelihoods: how the best fit worsens as one parameter is held away from it and all others are "
    "fitted again (solid; dots were computed). The 95 % interval is shaded: where the curve stays under the "
    "dashed line up to a bound, the data do not end it. Dashed: what the information at the optimum alone "
    "would say. Panels end at the bounds, or well above the line."
)
BASELINES_CAPTION = (
    "Mean in-plane error of the fitted model and of what it has to beat, on the same held-out points. The "
    "further left, the better; at the dashed noise floor an error is that of the measurement."
)
