"""All items of a job: tasks and executors come in; a manifest and a summary leave."""
