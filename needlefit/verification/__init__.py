"""Verify that the model is solved correctly: checks are measured on request, no result is stored."""
