"""Reports of the kinds of analyses: one file a kind, entered in `result_folder.ANALYSIS_PAGES`."""
