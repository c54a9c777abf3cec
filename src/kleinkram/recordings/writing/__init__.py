"""Writes recordings and tables: MCAP and Parquet."""
