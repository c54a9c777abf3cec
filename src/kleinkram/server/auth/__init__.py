"""Authentication: sign-in by provider, password or one-time link; sessions, second factors, and logins of the CLI."""
