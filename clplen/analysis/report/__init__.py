"""Tables and Markdown reports of a `Comparison`."""
