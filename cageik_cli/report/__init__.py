"""The record of a result and its views: text, tables, Markdown, JUnit, pictures, pages.

Depends on `store` and `posing`. Start with `record`, which computes every number once; the
views only show it. `limits` compares the numbers with limits, and `overview` is the record of a
batch.
"""
