"""`cageik view`: a page on this machine that plays a clip, poses it, and has handles applied.

`session.py` knows the model or the result and where outputs go, `run.py` does one edit at a time,
and `server.py` is all that speaks to a network. `show.py` makes such a page for a notebook.
"""
