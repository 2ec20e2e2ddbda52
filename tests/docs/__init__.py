"""The documents as tests: every code block runs, or says why it does not."""
