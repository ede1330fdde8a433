"""Pictures for displays, glasses and prints, and cameras for other programs; may import formats."""
