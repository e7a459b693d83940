"""What a hand does to a needle, and the needle it does it to."""
