"""C99 code from a generated module and its driver."""
