"""What the data determine: information, profiles, and whether they agree."""
