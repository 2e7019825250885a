"""The paper's variational experiments: a kaleidoscope, and a glass orb on a table, from images alone."""
