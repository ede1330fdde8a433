"""Plenoptic cameras: a scene comes in, the raw image of its light comes out.

Rooms: scenes < optics < exposure < the cameras themselves.
"""
