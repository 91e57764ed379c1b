"""Reproduction of Gamus & Or (2013): an application of gaitopt's public interface.

- ``gaits``: which problems the paper's gaits and families are, and where they are computed and kept
- ``table``: printed numbers and sentences beside the computed ones
- ``figures``: the figures
- ``reproduction``: what every part needs, computed on all cores and written
"""
