"""`cageik view`: a page on this machine that plays a clip, poses it, and has handles applied.

`session.py` knows the model or the result and where outputs go, `jobs.py` holds the edit that runs,
`requests.py` and `server.py` are all that speaks to a network; `run.py` puts them together.
"""
