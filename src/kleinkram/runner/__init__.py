"""Runs actions: claims runs, prepares their inputs, runs them by an executor, and uploads their results.

Communicates with the API and the object store over HTTPS, without credentials of a database or a store.
"""
