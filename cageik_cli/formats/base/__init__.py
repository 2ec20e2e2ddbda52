"""What file formats share: clips, writers, file names, polygons, HDF5.

Start with `sequence`, the clip that every reader gives, and `writer`, what every writer does;
`registry` finds the formats.
"""
