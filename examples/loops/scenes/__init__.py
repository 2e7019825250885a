"""What the loops find: scenes, each made by the library that renders it."""
