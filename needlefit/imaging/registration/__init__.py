"""Markers seen in a scan laid on their known places: `register` > `pairing`, `rigid`, `target_error`."""
