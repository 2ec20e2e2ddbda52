"""Weights fitted to clips: the weight step of `coordinates.fitting` alternates with the cage solve.

Depends on `coordinates` and on the rest of `solver`. Start with `fit`, which goes from clips to
fitted weights and a report; `sample` chooses frames, `alternate` fits, `held_out` measures frames
that were not fitted, `low_rank` and `influences` fit fewer numbers, `bound` says what is possible.
"""
