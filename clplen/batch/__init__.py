"""Many light fields: a job file comes in; results, their records and a manifest go out.

Rooms from the ground up: ``jobs``, ``work``, ``running``. ``preload`` is the entry of Dask workers.
"""

from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Report, Task
from clplen.batch.running.certificates import make_certificates
from clplen.batch.running.job import Job, run_job
from clplen.batch.running.network import security_of
from clplen.batch.running.runner import Summary, Watcher

__all__ = [
    "Job",
    "JobSpec",
    "Report",
    "Summary",
    "Task",
    "Watcher",
    "make_certificates",
    "run_job",
    "security_of",
]
