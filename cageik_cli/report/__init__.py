"""The record of a result and its views: text, Markdown, data for programs, pictures, pages.

Depends on `store` and `editing`. Start with `record`, which computes every number once; the
views only show it. `notes` say what stands out, `limits` compares the numbers with limits, and
`overview` is the record of a batch. Colours of plots are in `plots/style`, those of rendered
models in `render/shading`.
"""
