"""MCAP: records, the index, summaries, scans, writing."""
