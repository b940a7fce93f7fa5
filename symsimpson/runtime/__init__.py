"""Runtime of generated modules: cache, loader, driver, stepper. Knows nothing of SymPy."""
