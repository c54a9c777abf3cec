"""Grants of rights on projects and missions, and the access of people that follows from them."""
