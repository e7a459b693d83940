"""Kinds of study. Each is one folder: `schema` (its study file), `run` (its computation), `report`."""
