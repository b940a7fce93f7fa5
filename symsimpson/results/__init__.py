"""Results of runs: states, the quantities computed from them, and files."""
