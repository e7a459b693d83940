"""Predictions before any data: `studies/before_data.py`, its published moduli and its draws."""

import math
import runpy

import numpy as np
import pytest
from pytest import approx

from needlefit import open_scene
from needlefit.project.locate import shipped_folder

FUNCTIONS = runpy.run_path(str(shipped_folder() / "studies" / "before_data.py"))
read_moduli, predict_tips, share_variance = map(
    FUNCTIONS.get, ("read_moduli", "predict_tips", "share_variance")
)
EXACT = np.tile((100.0, 100.1), (4, 1))  # shear moduli of the layers of phantom1, kPa


def test_published_ranges_are_those_of_shear_moduli():
    assert read_moduli("Liver,2:10", 2) == approx(np.array([[0.9, 2.6], [2.0, 10.0]]))
    assert read_moduli("chicken", 3) == approx(np.tile((25.0, 35.0), (3, 1)))
    for media in ("liver,liver", "liver,steel,2:10", "bevel"):
        with pytest.raises(SystemExit):
            read_moduli(media, 3)


def test_a_tip_in_proportion_to_b_spreads_as_b_does():
    """Deflections of small needles are proportional to b, of which alone the prior is not exact."""
    tips, drawn = predict_tips(open_scene("phantom1"), EXACT, (0.0, 0.0), 1)
    low, median, high = np.quantile(tips[:, 1], [0.025, 0.5, 0.975])
    assert high / median == approx(1.7**1.96, rel=0.15) and low < median and len(tips) == 1000
    shares = share_variance(drawn, tips)["part of the variance"]
    assert shares.idxmax() == "b (mm)" and shares.max() > 0.99


def test_errors_of_the_entry_pose_move_the_tip():
    scene = open_scene("phantom1")
    turned = scene.depth * math.radians(0.5)
    tips, drawn = predict_tips(scene, EXACT * 1e-3, (0.4, 0.5), 1)
    assert np.std(tips[:, 2]) == approx(math.hypot(0.4, turned), rel=0.1)
    across = np.column_stack([tips[:, 0], 0 * tips[:, 1], tips[:, 2]])  # along z no parameter moves it
    shares = share_variance(drawn, across)["part of the variance"]
    names = ["place of the entry (mm)", "direction at the entry (degrees)"]
    assert shares[names].to_numpy() == approx(np.array([0.4, turned]) ** 2 / (0.4**2 + turned**2), abs=0.1)
