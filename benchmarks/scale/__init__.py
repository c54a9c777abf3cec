"""The rows about size: ten years of a lab's data, put straight into the database, and what asking for it then costs."""
