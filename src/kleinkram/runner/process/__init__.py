"""Runs as processes of this machine, where there is no engine of containers: for scripts, and for their own author.

A *warden* process per run starts it, bounds it and writes down how it ended. It outlives the runner, so that a runner
that comes back finds its runs as they are.
"""
