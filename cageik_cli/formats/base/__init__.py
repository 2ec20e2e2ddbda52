"""What file formats share: clips, writers, file names, polygons, HDF5.

Start with `base.sequence`, the clip that every reader gives, and `base.writers`, what every writer
does; `formats.open` and `formats.write` find the formats.
"""
