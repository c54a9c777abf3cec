"""Writes recordings and tables: MCAP, ROS 1 bag and Parquet."""
