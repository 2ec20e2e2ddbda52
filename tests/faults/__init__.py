"""Faults of the system, injected into runs of every command."""
