"""Columns, and marks in them, of the frames that figures of fits show."""

InsertionKey = tuple[str, str]  # fold and insertion
INSERTION_KEYS = ["fold", "insertion"]
HEIGHT_COLUMNS = ["y_mm", "low_mm", "high_mm"]
BAND_WHITE = {"95 %": 0.8, "50 %": 0.56}  # in place of a curve, a band: share of white in its colour
TIP_ERROR = "tip error"  # in place of a curve: the row is a tip error of a method
PROFILE_KEYS = ["fold", "parameter"]
VERDICT_COLUMNS = [  # of the identification
    *("fisher_sd", "low", "high", "end_low", "end_high", "rise"),
    *("interval_low", "interval_high", "draw_source", "bound_low", "bound_high"),
]
