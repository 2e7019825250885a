"""The paper's variational experiments: a kaleidoscope, a glass orb on a table, and a mug, from images alone."""
