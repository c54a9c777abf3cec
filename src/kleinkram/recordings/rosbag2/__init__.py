"""rosbag2: the SQLite database (db3), the metadata of a folder."""
