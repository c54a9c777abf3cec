"""Operations for admins of the server."""
