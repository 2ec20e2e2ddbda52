"""Captured clips: missing vertices, outliers, gaps, and noise over time.

Depends on `method`. `frames` prepares a block, `robust` finds outliers, `fill` closes gaps, and
`smooth` smooths cages over time.
"""
