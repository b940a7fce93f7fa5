"""Runs of all kinds, and what they came to."""
