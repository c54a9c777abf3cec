"""Uploads: begin, sign parts, complete. After a crash at any point, files are whole and names become free."""
