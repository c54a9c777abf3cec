"""MCAP: records, index, scan and messages."""
