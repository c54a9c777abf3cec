"""Uploads: begin -> parts -> complete. A crash anywhere leaves no file that lies and no name that is blocked."""
