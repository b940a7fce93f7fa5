"""What runs a kernel: LLVM, Python in many digits, C."""
