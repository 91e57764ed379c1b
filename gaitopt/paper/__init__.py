"""Reproduction of Gamus & Or (2013): an application of gaitopt's public interface.

- ``gaits``: the problems of the paper's gaits and families, and the archive that computes and keeps them
- ``table``: printed numbers and sentences beside the computed ones
- ``figures``: the figures
- ``reproduction``: computes everything on all cores and writes it
"""
