"""MCAP: records, index, scan, messages, writer."""
