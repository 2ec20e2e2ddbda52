"""Joints for programs that skin.

Depends on `fit` and `method`. Start with `turning`, the fit of weights for joints; `merging` merges
joints and groups them by parts of the body, and `joints` turns them.
"""
