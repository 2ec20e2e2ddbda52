"""One writer a kind of file: each module holds a `Writer`, an AnimationWriter."""
