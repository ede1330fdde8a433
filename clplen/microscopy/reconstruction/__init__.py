"""From volumes to frames and back: projectors, Richardson and Lucy's iteration, priors."""
