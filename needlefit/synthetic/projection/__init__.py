"""Render CT volumes in projection space: path lengths, spectrum, noise and filtered back projection."""
