"""Measures of one picture, point or wavefront: arrays with a pitch come in; numbers leave."""
