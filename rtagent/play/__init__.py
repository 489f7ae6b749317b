"""Experiment 2 as a little game for one person, in the terminal or with the button of the live page."""
