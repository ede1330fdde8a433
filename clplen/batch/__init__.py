"""Many light fields: jobs, their items, a manifest of what is done, workers."""

from clplen.batch.certificates import make_certificates
from clplen.batch.job import Job
from clplen.batch.network import security_of

__all__ = ["Job", "make_certificates", "security_of"]
