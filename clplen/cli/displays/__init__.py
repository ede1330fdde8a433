"""Commands for displays and other programs; may import shared."""
