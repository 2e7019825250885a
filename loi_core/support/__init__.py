"""Small helpers that know nothing of images: arrays of any library, the wording of messages, caches, checks."""
