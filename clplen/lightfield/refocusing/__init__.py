"""Refocused pictures of a light field on a device: on one plane, a surface, many planes, a range
of depths. What comes in is a `LightField` and planes; what leaves is an `Image`, a `FocalStack`, a
filtered `LightField`, or what such a computation needs of memory."""
