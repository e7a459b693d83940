"""Run studies: fit to some insertions, score on others (`run`), and compare with the published numbers
(`paper`).
"""
