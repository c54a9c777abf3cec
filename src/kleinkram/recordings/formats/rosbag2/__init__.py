"""rosbag2: SQLite databases (db3) and the metadata of a folder."""
