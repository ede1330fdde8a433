"""Codecs, one per module: pictures, floats, points and byte containers, to and from arrays.

Functions take arrays and paths and return arrays or write files, without light fields or devices.
`clplen.io.formats.untrusted` limits the memory that untrusted files may use.
"""
