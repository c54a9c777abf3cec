"""Runners: machines that claim runs, and the requests about runs that they have."""
