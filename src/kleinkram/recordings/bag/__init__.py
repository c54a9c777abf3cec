"""ROS 1 bags 2.0: records, summaries, scans, writing."""
