"""The rows about size: ten years of a lab's data, inserted into the database, and the cost of requests for it."""
