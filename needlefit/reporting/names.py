"""How rivals, media and groups are called in print, and in which colour they are drawn."""

from needlefit.validation.results import Results

INK, GREY, PAPER, SYNTHETIC = "#1a1a1a", "#8a8a8a", "#D55E00", "#B23A00"

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
METHOD_COLOURS = {  # Okabe and Ito's palette, told apart by colour-blind readers
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
WAY_NAMES = {
    "inflated": "old posterior, inflated",
    "new": "new insertions alone",
    "none": "no update",
}
"""How a new medium is known in an adaptation."""
WAY_COLOURS = {"inflated": "#0072B2", "new": "#009E73", "none": "#8a8a8a"}
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
"""What is told of a parameter of a population of specimens."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, 0 to 1, of a colour "#rrggbb"."""
    red, green, blue = (round(int(colour[i : i + 2], 16) / 255, 6) for i in (1, 3, 5))
    return red, green, blue


def medium_name(name: str) -> str:
    """Return a medium as print has it: `phantom2` is "phantom 2"."""
    stem = name.rstrip("0123456789")
    return f"{stem} {name[len(stem) :]}".strip().replace("_", " ")


def study_name(label: str | int) -> str:
    """Return "study 3" for the paper's third; another study by its own name."""
    return f"study {label}" if isinstance(label, int) else str(label)


def layers_name(layers: int) -> str:
    """Return "1 layer", "3 layers"."""
    return f"{layers} layer" if layers == 1 else f"{layers} layers"


def way_in_name(entry: str, angle_deg: float) -> str:
    """Return an entry, and the angle at which a needle would go in there."""
    return entry if angle_deg == 0 else f"{entry}, {angle_deg:g}°".replace("-", "−")


def method_name(method: str, results: Results) -> str:
    """Return the method's name; on synthetic data the paper's set was not tuned on this data."""
    name = METHOD_NAMES.get(method, method)
    foreign = method == "hand_tuned" and results.origin == "synthetic"
    return f"{name} (not tuned on this data)" if foreign else name
