"""The solve for all frames: align, solve for the cages, measure the reconstruction.

Depends on `weights` and `geometry`. Start with `dual_laplacian`, which factors the normal
matrix once and solves blocks of frames; `alignment` and `metrics` stand before and after it.
"""
