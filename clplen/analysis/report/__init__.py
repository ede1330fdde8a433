"""Comparisons in words: a `Comparison` comes in; tables and Markdown text leave."""
