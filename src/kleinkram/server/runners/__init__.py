"""Runners: machines that ask for runs, and what they may say of those that they hold."""
