"""Weights fitted to displacements: one least-squares problem over W for given cages.

Depends on `geometry`. Start with `problem`, which states the problem and solves it; `affine` keeps
the weights affine-exact, `systems` solves the sparse systems, `low_rank` and `simplex` are the same
problem over fewer weights. The cages themselves are solved on the floor above.
"""
