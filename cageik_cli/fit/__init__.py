"""Weights that are fitted to clips: cages and weights in turn.

Depends on `method`. Start with `fit`; `settings` says what a fit takes and what is recorded of it.
"""
