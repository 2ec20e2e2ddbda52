"""Joints for programs that skin: influences, merged joints, and joints that turn.

Depends on `fit`, `method` and `geometry`. Start with `joints`, which solves for joints that turn
and fits weights to them; `merging` makes them fewer, `jumps` smooths them over time.
"""
