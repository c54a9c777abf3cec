"""Recordings written as MCAP and Parquet."""
