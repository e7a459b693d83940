"""Run studies: fit some insertions, score others, judge the fits, and report what was found."""
