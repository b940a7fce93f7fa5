"""Runtime of generated modules: cache, driver, programs, runs, results. Knows nothing of SymPy."""
