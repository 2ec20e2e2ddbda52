"""Joints for programs that skin: influences, merged joints, and joints that turn.

Depends on `fit`, `method` and `geometry`. Start with `joints`, which solves for joints that turn;
`turning` fits weights to them, and `merging` makes them fewer.
"""
