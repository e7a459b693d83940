"""Check by simulation that the computed uncertainty is right if the model is (simulation-based
calibration).
"""
