"""Files: whole or not at all, whatever they hold: images, arrays, tables, and the folder of a result."""
