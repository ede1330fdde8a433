"""Pictures for displays, glasses and prints, and cameras for other programs.

Modules may import `clplen.io.formats`.
"""
