"""HTTP: the web server, middleware, error responses, and what routes share."""
