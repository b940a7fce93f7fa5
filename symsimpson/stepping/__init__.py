"""Requests for runs, read once, and the run under way."""
