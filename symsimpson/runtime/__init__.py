"""What runs a generated module: cache, loader, driver, stepper. Knows nothing of SymPy."""
