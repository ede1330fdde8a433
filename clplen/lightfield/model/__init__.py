"""The light field, on a device or stored, and its pictures; may import arrays and raw."""
