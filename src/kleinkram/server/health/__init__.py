"""Health: is this process alive, is it ready to serve, what does it measure, and what is it."""
