"""Job descriptions: turn a job file or keyword arguments into a list of tasks."""
