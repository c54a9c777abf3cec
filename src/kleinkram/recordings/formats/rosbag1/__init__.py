"""ROS 1 bag 2.0: records, index, scan and messages."""
