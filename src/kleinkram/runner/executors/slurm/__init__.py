"""Runs jobs on a Slurm cluster, as an ordinary user of a login node."""
