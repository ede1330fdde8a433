"""Matching of views with the centre view on planes of disparity: costs and planes."""
