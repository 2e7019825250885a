"""Table 1 of the paper: the places of disks of known colour, found from an image."""
