"""Checkpoints: all that a run knows, in a file, so that it goes on from there as if it had never stopped."""
