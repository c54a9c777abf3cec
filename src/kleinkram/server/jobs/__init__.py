"""Background jobs: the queue, and the worker that runs what features put into it."""
