"""The state of a workflow run: finished and running jobs, failures, cost and time remaining."""
