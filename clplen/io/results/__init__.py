"""What is computed from light fields: stacks, depth, truth, volumes and pictures, in files.

Results come in and files leave, and the other way round; may import every other room of
`clplen.io`.
"""
