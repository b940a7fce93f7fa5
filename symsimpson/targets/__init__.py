"""Targets of the kernel language: LLVM, Python in many digits, C, counts of operations."""
