"""Settings of operations, declared once for Python, files and commands."""
