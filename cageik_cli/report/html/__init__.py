"""The page of a result and the index of a batch: one HTML file each, with no network."""
