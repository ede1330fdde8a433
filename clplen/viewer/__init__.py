"""Viewer of light fields, stacks and volumes: pages, a local server, a notebook widget."""
