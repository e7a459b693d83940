"""How layers are drawn: the stiffer, the darker."""

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from needlefit.mechanics.scene import Scene
from needlefit.mechanics.tissue import Tissue
from needlefit.reporting.numbers import number, typeset

_LETTER, _ROOM, _WIDEST_MODULUS = 0.055, 0.05, 0.58  # inches, of 6.5 point type
Colour = tuple[float, float, float, float]

_LAYERS = LinearSegmentedColormap.from_list("layers", ["#f7f4ee", "#d3c7ae"])


def shades(tissue: Tissue) -> list[Colour]:
    """Return one colour a layer."""
    stiffness = np.log10(tissue.mu)
    decades = max(float(np.ptp(stiffness)), 1.0)  # one at least, so that like layers look alike
    return [_LAYERS(float((one - stiffness.min()) / decades)) for one in stiffness]


def layer_labels(scene: Scene, widths: Mapping[int, float], one_line: bool = False) -> dict[int, str]:
    """Return what is written on the layers (counted from 0) that are so wide on paper, in inches.

    All of them are called in the same way: by the scene's own names if these fit, or "layer 1", or "1". Its
    modulus stands below, or with `one_line` behind, where a layer has room for it.
    """
    numbered = {i: f"layer {i + 1}" for i in widths}
    own = {i: (scene.layer_names[i] if scene.layer_names else "") or called for i, called in numbered.items()}
    said = {i: f"{i + 1}" for i in widths}
    for names in (own, numbered):
        if all(_LETTER * len(name) + _ROOM <= widths[i] for i, name in names.items()):
            said = names
            break
    return {i: f"{called}{_modulus(scene, i, widths[i], called * one_line)}" for i, called in said.items()}


def _modulus(scene: Scene, layer: int, width: float, before: str) -> str:
    """Return a layer's modulus, below its name or, where it is given, behind; "" where there is no room."""
    if width <= _WIDEST_MODULUS + _LETTER * len(before):
        return ""
    return f"{', ' if before else chr(10)}{typeset(number(scene.tissue.mu[layer] * 1e6))} Pa"
