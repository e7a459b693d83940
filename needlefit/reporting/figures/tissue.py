"""How layers are drawn: the stiffer, the darker."""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from needlefit.mechanics.tissue import Tissue
from needlefit.reporting.numbers import number, typeset

Colour = tuple[float, float, float, float]

_LAYERS = LinearSegmentedColormap.from_list("layers", ["#f7f4ee", "#d3c7ae"])


def shades(tissue: Tissue) -> list[Colour]:
    """Return one colour a layer."""
    stiffness = np.log10(tissue.mu)
    decades = max(float(np.ptp(stiffness)), 1.0)  # one at least, so that like layers look alike
    return [_LAYERS(float((one - stiffness.min()) / decades)) for one in stiffness]


def layer_label(tissue: Tissue, layer: int, inches: float) -> str:
    """Return what is written on a layer (counted from 0) that is so wide on paper."""
    modulus = f"{typeset(number(tissue.mu[layer] * 1e6))} Pa"
    if inches > 0.75:
        return f"layer {layer + 1}\n{modulus}"
    return f"{layer + 1}\n{modulus}" if inches > 0.58 else f"{layer + 1}"
