"""Options that commands share, and the checks of what was typed."""
