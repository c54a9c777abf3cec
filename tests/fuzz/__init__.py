"""Mutated recordings, and what must hold whatever the bytes: no crash, no hang, no swelling.

A case is a number, and a number always makes the same case. `python -m tests.fuzz --minutes 20` is the long run; a
short one belongs to `make test`. What the long run finds becomes a small generated test beside the code it hit.
"""
