"""The record as text: terminal, CSV, JSON, JUnit XML, Markdown."""
