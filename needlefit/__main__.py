"""`python -m needlefit` is `needlefit`."""

from needlefit.cli import main

main()
