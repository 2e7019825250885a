"""The loss on an NVIDIA GPU, in kernels written in Triton."""
