"""Which page tells which kind of inquiry."""

from collections.abc import Mapping
from types import MappingProxyType

from needlefit.reporting.inquiries import (
    adaptation,
    comparison,
    left_out,
    next_insertion,
    plan,
    seeds,
    sensitivity,
    specimens,
)
from needlefit.reporting.inquiries.page import Page

PAGES: Mapping[str, Page] = MappingProxyType(
    {
        "adaptation": adaptation.PAGE,
        "comparison": comparison.PAGE,
        "left_out": left_out.PAGE,
        "next_insertion": next_insertion.PAGE,
        "plan": plan.PAGE,
        "seeds": seeds.PAGE,
        "sensitivity": sensitivity.PAGE,
        "specimens": specimens.PAGE,
    }
)
