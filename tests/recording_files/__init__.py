"""Makers and readers of recordings that several kinds of test share."""
