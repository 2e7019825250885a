"""A stand-in for PyTorch3D on the library's own rasteriser, with the names that a loop uses and their conventions."""
