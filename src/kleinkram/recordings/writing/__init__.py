"""Writes recordings, tables and images: MCAP, ROS 1 bag, Parquet, CSV, PNG and JPEG."""
