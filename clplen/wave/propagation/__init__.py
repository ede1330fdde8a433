"""Free space: a field and a distance come in, the field at that distance goes out."""
