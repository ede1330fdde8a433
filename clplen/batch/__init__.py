"""Many light fields: jobs, their items, a manifest of what is done, workers."""

from clplen.batch.jobs.spec import Job
from clplen.batch.running.certificates import make_certificates
from clplen.batch.running.network import security_of

__all__ = ["Job", "make_certificates", "security_of"]
