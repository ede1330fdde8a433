"""Processing of an item: execute a task, write its result files, return a report."""
