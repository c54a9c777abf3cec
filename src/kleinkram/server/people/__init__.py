"""People: who knows of whom, who is an admin, and what ends when somebody leaves."""
