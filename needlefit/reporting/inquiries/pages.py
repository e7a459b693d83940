"""Which page tells which kind of inquiry."""

from collections.abc import Mapping
from types import MappingProxyType

from needlefit.reporting.inquiries import adaptation, left_out, next_insertion, seeds, sensitivity
from needlefit.reporting.inquiries.page import Page

PAGES: Mapping[str, Page] = MappingProxyType(
    {
        "adaptation": adaptation.PAGE,
        "left_out": left_out.PAGE,
        "next_insertion": next_insertion.PAGE,
        "seeds": seeds.PAGE,
        "sensitivity": sensitivity.PAGE,
    }
)
