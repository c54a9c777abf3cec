"""Audit: the record of what happened. Written in the transaction of the change it tells of."""
