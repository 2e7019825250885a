"""Fitting the parameters of a scene to an image: the loop, its optimiser, and its checkpoints."""
