"""Fit the parameters of a scene to an image: the loop, its schedule, its optimiser and its checkpoints."""
