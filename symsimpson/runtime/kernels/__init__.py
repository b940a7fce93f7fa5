"""The kernels of a generated module: read, checked, compiled, kept; in any numbers."""
