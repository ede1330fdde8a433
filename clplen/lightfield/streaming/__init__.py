"""Light fields larger than memory, tile by tile. What comes in is a `StoredLightField` and a budget
of bytes; what leaves is what the rooms below make of a whole light field, with the same values."""
