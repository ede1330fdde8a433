"""Commands that write files for displays and other programs; may import shared."""
