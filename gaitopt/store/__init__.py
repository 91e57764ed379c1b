"""Files of run folders: whole files, JSON lines that survive a kill, manifests and locks.

What cannot be written, is missing or altered raises a ``StorageError`` that names the place.
"""
