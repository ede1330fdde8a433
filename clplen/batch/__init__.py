"""Many light fields: jobs, their items, a manifest of what is done, workers."""

from clplen.batch.job import Job

__all__ = ["Job"]
