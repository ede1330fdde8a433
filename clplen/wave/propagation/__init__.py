"""Free-space propagation of fields: methods, plans and reports."""
