"""The compiled loops over steps, blocks and states, which call kernels by address."""
