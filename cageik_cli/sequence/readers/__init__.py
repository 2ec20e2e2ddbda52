"""One reader a kind of file: each module holds a `Reader`, a MeshSequence made from paths."""
