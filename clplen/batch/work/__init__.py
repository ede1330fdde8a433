"""One item of a job: a task comes in; its result files and a report leave."""
