"""Reports of analyses: one file for each kind of analysis, listed in `result_folder.ANALYSIS_PAGES`."""
