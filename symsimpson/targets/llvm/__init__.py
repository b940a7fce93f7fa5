"""LLVM code from the text of a kernel: a walker visits its syntax tree and emits instructions."""
