"""Captured clips: missing vertices, outliers, gaps, and noise over time.

Depends on `method`. Start with `frames`, which solves a block of frames with what is missing;
`robust` finds outliers, `fill` closes gaps, and `smooth` smooths cages over time.
"""
