"""A plugin of needlefit, as its users write them: every module here adds one thing.

needlefit registers what stands in this module.
"""

from needlefit_example.baseline import PARABOLA
from needlefit_example.depth_study import KIND as DEPTH_STUDY
from needlefit_example.file_format import XYZ
from needlefit_example.law import LOGARITHMIC
from needlefit_example.metric import END_ERROR
from needlefit_example.observation import ULTRASOUND
from needlefit_example.sampler import RANDOM_WALK

__all__ = ["DEPTH_STUDY", "END_ERROR", "LOGARITHMIC", "PARABOLA", "RANDOM_WALK", "ULTRASOUND", "XYZ"]
