from .running.estimate import estimate_job as estimate_job
from .running.job import Job as Job
from .running.job import run_job as run_job
from .running.manifest import status_of as status_of
from .running.network import security_of as security_of
from .running.runner import Summary as Summary
