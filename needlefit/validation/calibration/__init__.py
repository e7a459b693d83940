"""Simulation-based calibration: is the uncertainty that is computed the right one, if the model is?"""
