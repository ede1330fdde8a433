"""Helpers of several commands: what users type comes in; values, notes and written files leave."""
