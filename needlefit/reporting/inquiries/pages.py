"""Which page tells which kind of inquiry."""

from collections.abc import Mapping
from types import MappingProxyType

from needlefit.reporting.inquiries import left_out, next_insertion, plan, specimens
from needlefit.reporting.inquiries.page import Page

PAGES: Mapping[str, Page] = MappingProxyType(
    {
        "left_out": left_out.PAGE,
        "next_insertion": next_insertion.PAGE,
        "plan": plan.PAGE,
        "specimens": specimens.PAGE,
    }
)
