"""What is visible where, by loops over triangles and pixels that Numba compiles."""
