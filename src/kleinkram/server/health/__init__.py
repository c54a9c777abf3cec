"""Health: is this process alive, is it ready to serve, and what is it."""
