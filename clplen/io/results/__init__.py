"""Files of results: focal stacks, depth, ground truth, volumes and pictures.

Functions write results to files and read them back. Modules may import every other room of
`clplen.io`.
"""
