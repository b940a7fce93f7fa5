"""Runs of all kinds: integration, events, derivatives, checkpoints and verdicts."""
