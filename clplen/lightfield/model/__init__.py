"""The light field, on a device or stored, and its pictures; imports arrays and raw only."""
