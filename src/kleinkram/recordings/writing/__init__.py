"""Writes recordings, tables and images: MCAP, Parquet, CSV, PNG and JPEG."""
