"""One codec a file: pictures, floats, points and containers of bytes, to and from arrays.

Arrays and paths come in, arrays and files leave; no light field, no device. Files of unknown origin
are bounded by `clplen.io.formats.untrusted`.
"""
