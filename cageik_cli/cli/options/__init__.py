"""Options that commands share, and the records that they make."""
