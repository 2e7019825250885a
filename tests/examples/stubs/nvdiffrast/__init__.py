"""A stand-in for nvdiffrast on a processor, with the operations that a loop uses and their conventions."""
