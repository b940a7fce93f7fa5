"""Single runs: their start, steps, checkpoints, and checks of their energy."""
