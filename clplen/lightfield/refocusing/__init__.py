"""Refocused pictures of a light field on a device: one plane, a surface, many planes, a range."""
