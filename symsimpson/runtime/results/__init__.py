"""Results of runs: states, times and quantities that follow from them; files of these."""
