"""Runs of jobs: execute tasks, keep the manifest, return a summary."""
