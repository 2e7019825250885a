"""Dr.Jit's LLVM, arrays and tables."""
